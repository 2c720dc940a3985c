"""Headless Chromium over its DevTools pipe, with the standard library alone."""

import fcntl
import json
import os
import select
import shutil
import signal
import time
from contextlib import contextmanager

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)


# parts whose text passes the sheet's edge or their own; table words broken over lines;
# figures that the text needs and the provenance, where they are not drawn: all but what
# is folded in a closed chapter
LACKING = """(() => {
  const told = (e) => `${e.tagName} ${e.className}: ${e.textContent.slice(0, 60)}`;
  const shown = [...document.querySelectorAll('body *')].filter(
    (e) => e.checkVisibility() && !e.closest('svg, .unseen, .skip, script'));
  const clips = (e) => getComputedStyle(e).overflowX !== 'visible';
  const cut = shown.filter((e) => e.getBoundingClientRect().right > innerWidth + 1
    || (clips(e) && e.scrollWidth > e.clientWidth + 1));
  const broken = shown.filter((e) => e.closest('th, td') && !e.closest('pre')).flatMap(
    (e) => [...e.childNodes].filter((n) => n.nodeType === 3).flatMap(
      (n) => [...n.data.matchAll(/[^\\s,-]+/g)].map((word) => {
        const range = document.createRange();
        range.setStart(n, word.index);
        range.setEnd(n, word.index + word[0].length);
        return new Set([...range.getClientRects()].map((b) => Math.round(b.top)));
      }).filter((tops) => tops.size > 1).map(() => e)));
  const inner = '.chapter:not([open]) details:not([open]) *';
  const drawn = [...document.querySelectorAll('figure, dl, pre')].filter(
    (e) => !e.matches(inner) && !e.checkVisibility());
  return [...cut, ...broken, ...drawn].map(told);
})()"""


def find_chromium():
    """Path of the browser, or None."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((path for name in names if (path := shutil.which(name))), None)


class Browser:
    """One page of a browser."""

    def __init__(self, reader, writer):
        self._reader, self._writer = reader, writer
        self._buffer, self._number, self.events = b"", 0, []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = None
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        """Call a method of the protocol and return its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if getattr(self, "_session", None):
            message["sessionId"] = self._session
        os.write(self._writer, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def _next(self, seconds=300):
        # a machine that others keep busy takes minutes for axe-core on a long page
        deadline = time.monotonic() + seconds
        while b"\0" not in self._buffer:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._reader], [], [], left)[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self._reader, 1 << 20)
            if not part:
                raise RuntimeError("the browser has gone")
            self._buffer += part
        text, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(text)

    def open(self, path, *, width=1280, height=900, scheme="light"):
        """Open a file at a width in CSS pixels and a colour scheme."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.call("Emulation.setEmulatedMedia", features=[feature])
        self.events.clear()
        self.call("Page.navigate", url=path.resolve().as_uri())
        while not any(e.get("method") == "Page.loadEventFired" for e in self.events):
            self.events.append(self._next())

    def run(self, expression):
        """Value of a JavaScript expression in the page."""
        answer = self.call(
            "Runtime.evaluate",
            expression=expression,
            returnByValue=True,
            awaitPromise=True,
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(json.dumps(answer["exceptionDetails"])[:500])
        return answer["result"].get("value")

    def printed(self, path, width):
        """What a sheet so many pixels wide lacks: text cut off, figures not drawn."""
        self.open(path, width=width, height=1047)
        self.call("Emulation.setEmulatedMedia", media="print")
        try:
            return self.run(LACKING)
        finally:
            self.call("Emulation.setEmulatedMedia", media="")

    def press(self, key, code, text=""):
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                windowsVirtualKeyCode=code,
                text=text if kind == "keyDown" else "",
            )

    def requests(self):
        """Addresses that the page has asked for since it was opened."""
        return [
            event["params"]["request"]["url"]
            for event in self.events
            if event.get("method") == "Network.requestWillBeSent"
        ]

    def complaints(self):
        """Errors, warnings and exceptions in the console since it was opened."""
        found = []
        for event in self.events:
            parameters = event.get("params", {})
            if event.get("method") == "Runtime.exceptionThrown":
                found.append(json.dumps(parameters["exceptionDetails"]))
            if event.get("method") == "Runtime.consoleAPICalled":
                found.append(json.dumps(parameters["args"]))
            if event.get("method") == "Log.entryAdded":
                found.append(parameters["entry"]["text"])
        return found


@contextmanager
def browser(folder):
    """Start Chromium with an empty profile in `folder` and stop it afterwards."""
    commands, answers = os.pipe(), os.pipe()
    # away from 3 and 4, where the browser expects its ends
    ends = [fcntl.fcntl(fd, fcntl.F_DUPFD, 20) for fd in (commands[0], answers[1])]
    path, nothing = find_chromium(), os.open(os.devnull, os.O_RDWR)
    actions = [(os.POSIX_SPAWN_DUP2, nothing, k) for k in range(3)]
    actions += [(os.POSIX_SPAWN_DUP2, end, 3 + k) for k, end in enumerate(ends)]
    arguments = [path, *FLAGS, f"--user-data-dir={folder}", "about:blank"]
    child = os.posix_spawn(path, arguments, os.environ, file_actions=actions)
    for end in (commands[0], answers[1], nothing, *ends):
        os.close(end)
    try:
        yield Browser(answers[0], commands[1])
    finally:
        os.close(commands[1])  # the browser ends when its pipe does
        _end(child)
        os.close(answers[0])


def _end(child):
    deadline = time.monotonic() + 10
    while os.waitpid(child, os.WNOHANG) == (0, 0):
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return
        time.sleep(0.05)
