"""The long description of the package: README.md, whole where its files are not."""

import re
from pathlib import Path

IMAGE = re.compile(r"!\[([^\]]*)\]\((?!\w+:)([^)]+)\)")
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!\w+:)([^)#]+)(?:#[^)]*)?\)")
EITHER = re.compile(r"(!?\[[^\]]*\]\()(?!\w+:|#)")


def described(text, base=""):
    """README's text for a page that is not beside the repository's files.

    With the address of the files every link and picture is absolute. Without one, a
    picture is its description, and a link its words and the path of the file.
    """
    if base:
        return EITHER.sub(rf"\g<1>{base.rstrip('/')}/", text)
    return LINK.sub(_path, IMAGE.sub(r"*Figure: \1 (`\2`)*", text))


def _path(link):
    words, path = link.groups()
    return words if path in words else f"{words} (`{path}`)"


def dynamic_metadata(settings, project):
    """Give the build backend the description; `base` is the files' address, if any."""
    del project  # the protocol's; nothing of it is needed
    readme = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
    text = described(readme, settings.get("base", ""))
    return {"readme": {"content-type": "text/markdown", "text": text}}
