"""Pictures with their capture times: a V4L2 device, files, or a played recording. Sources handle device faults
themselves.

Public:

- `discovery`: `device_paths`, `stable_names`
- `factory`: `open_camera`
- `file_stamps`: `spread_within_seconds`
- `format_negotiation`: `sizes_text`
- `photo_metadata`: `Focal`, `PhotoMetadata`, `read_photo`
- `picture_files`: `FrameSource`, `PICTURE_SUFFIXES`, `open_frames`, `read_grey`
- `playback`: `PREFIX`
- `pixel_formats`: `DECODERS`, `UNDECODABLE`
- `v4l2_camera`: `V4l2Camera`
- `v4l2_device`: `Control`, `Device`, `Sizes`, `V4l2Device`
"""
