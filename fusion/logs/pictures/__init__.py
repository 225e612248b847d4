"""A camera's pictures: folders of image files, and videos.

Begin reading at `fusion.logs.pictures.camera_folder` (a camera of a flight folder),
`fusion.logs.pictures.picture_folder` or `fusion.logs.pictures.video` (separate log formats).
"""
