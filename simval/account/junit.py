"""An account as JUnit XML: a case for each answer."""

import re
from typing import Final
from xml.etree import ElementTree

from simval.account import Account

_NOT_XML: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def text(account: Account) -> str:
    """Write a test suite in XML: a failure for each No, an error for each doubt.

    Parameters
    ----------
    account : Account
        What there is to say.

    Returns
    -------
    str
        With a declaration.
    """
    answers = [reply.answer for reply in account.replies]
    counts = {
        "tests": str(len(answers)), "failures": str(answers.count("fail")),
        "errors": str(answers.count("inconclusive")),
    }  # fmt: skip
    root = ElementTree.Element("testsuites", {"name": clean(account.name)} | counts)
    head = {"name": clean(account.name)} | counts
    suite = ElementTree.SubElement(root, "testsuite", head)
    for reply in account.replies:
        case = ElementTree.SubElement(
            suite, "testcase", classname=clean(account.title), name=clean(reply.title)
        )
        if reply.answer != "pass":
            tag = "failure" if reply.answer == "fail" else "error"
            said = ElementTree.SubElement(case, tag, message=clean(reply.headline))
            said.text = clean("\n".join([reply.do, *reply.lines]))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def clean(words: str) -> str:
    """Remove the characters that XML does not allow."""
    return _NOT_XML.sub("\ufffd", words)
