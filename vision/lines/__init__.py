"""Line segments in a picture: edges, then segments. Begin reading at `vision.lines.segments`."""
