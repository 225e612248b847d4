"""A camera's pictures: folders of image files, and videos."""
