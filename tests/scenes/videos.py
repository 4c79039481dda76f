"""Videos of a camera's codes, without loss."""


def write_video(path, codes, rate=100, first=0):
    """Write (frames, rows, columns, 3) codes of 8 bits; the first frame's time is in seconds."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate)
        stream.height, stream.width = codes.shape[1:3]
        stream.pix_fmt = "bgr0"
        for k, each in enumerate(codes):
            frame = av.VideoFrame.from_ndarray(each, format="rgb24")
            frame.pts = first * rate + k
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
