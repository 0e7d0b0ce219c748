"""`pc-ground web`: a page on which an operator clicks the pictures, sees pins on a map and passes them on.

Everything but `command` needs the extra `web` (FastAPI, uvicorn, Pillow, segno) and is imported only when a page is
served.
The page itself (TypeScript in frontend/) is bundled into `ground/web/static` when the project is built.

What other packages take from here: `command.add_arguments` and `command.run`.
"""
