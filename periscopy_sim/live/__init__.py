"""A laboratory to move by hand: pictures of whatever is set, and the page that shows them."""
