"""How well a scene at some values explains a photograph, whatever image and light."""
