"""Pictures with their capture times: a V4L2 device, a helper program (RTSP, libcamera, GStreamer, one's own), files, or
a played recording. Sources handle device faults themselves.

Public:

- `discovery`: `device_paths`, `stable_names`
- `factory`: `open_camera`, `open_device`, `open_second_camera`, `second_section`
- `file_stamps`: `read_stamps`, `spread_within_seconds`, `stamp_from_name`, `stamps_of_frames`
- `format_negotiation`: `sizes_text`
- `helper_launch`: `RTSP`, `decoders_text`, `helper_launch`, `libcamera_names`, `unable`
- `known_lenses`: `GIVEN_SIGMA`, `Lens`, `first_camera_file`, `known_lens`, `named_lens`
- `photo_lens`: `FULL_FRAME_DIAGONAL_MM`
- `photo_metadata`: `Focal`, `PhotoMetadata`, `read_photo`
- `picture_files`: `FrameSource`, `PICTURE_SUFFIXES`, `Video`, `open_frames`, `read_grey`
- `picture_mask`: `read_mask`
- `playback`: `PREFIX`, `PlayedCamera`
- `pixel_formats`: `DECODERS`, `UNDECODABLE`
- `rig_bands`: `one_band`
- `video_times`: `frame_times_s`, `rate_text`
- `v4l2_device`: `Control`, `Device`, `Sizes`, `V4l2Device`
"""
