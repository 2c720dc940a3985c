"""What each face of an account shows at once, for the tests of accounts."""

import json
import re
from html import unescape

from simval.account.html import fragment
from simval.account.markdown import safe, text
from simval.account.terminal import lines


def bare(words):
    """The words of a text, one blank between them."""
    return " ".join(words.split())


def shown(account):
    """What each face shows at once, and how it spells what it is given."""
    short = {w: bare("\n".join(lines(account, width=w))) for w in (60, 100)}
    html, markdown = fragment(account), text(account)
    return [
        *((found, bare) for found in short.values()),
        (bare(unescape(re.sub("<details>.*?</details>|<[^>]*>", " ", html))), bare),
        (bare(markdown.partition("<details>")[0]), safe),
    ]


def must_be_seen(account):
    """What no face may leave out: verdicts, reasons, what to do, and warnings."""
    for reply in account.replies:
        yield from (reply.title, reply.headline, reply.do)
    yield from (each.words for each in account.warnings)


def check_faces(account):
    for face, spelled in shown(account):
        for words in must_be_seen(account):
            assert spelled(words) in face, words
        for values in account.values:
            for line in values.lines:
                for number in line.spelled:
                    assert not line.notable or spelled(number) in face
    whole = json.dumps(account.as_object())
    for words in must_be_seen(account):
        assert json.dumps(words)[1:-1] in whole
