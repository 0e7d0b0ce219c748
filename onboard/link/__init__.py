"""Sets, status and replies over zenoh within a bit rate, clicks and sets through the autopilot's radio; certificates.

Public:

- `autopilot_radio`: `AutopilotRadio`, `radio_bucket`
- `byte_budget`: `left_for_pictures`
- `certificates`: `AUTHORITY`, `make_credentials`
- `picture_sender`: `PictureSender`
- `publisher`: `Publisher`, `Rate`
- `status_query`: `ask`
"""
