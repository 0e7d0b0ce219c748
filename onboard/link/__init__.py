"""Sets, status and replies over zenoh within a bit rate; certificates.

Public:

- `byte_budget`: `left_for_pictures`
- `certificates`: `AUTHORITY`, `make_credentials`
- `click_desk`: `ClickDesk`
- `picture_sender`: `PictureSender`
- `publisher`: `Publisher`
- `status_query`: `ask`
"""
