"""Videos of a camera's codes, without loss."""


def write_video(path, codes, rate=100):
    """Write (frames, rows, columns, 3) codes of 8 bits."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate)
        stream.height, stream.width = codes.shape[1:3]
        stream.pix_fmt = "bgr0"
        for each in codes:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(each, format="rgb24")))
        container.mux(stream.encode(None))
