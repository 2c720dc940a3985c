"""Ways in which a plug-in's process may lie: messages, made from an honest one."""

import json
import pickle

import numpy as np

from simval.plugins.messages import LENGTH, Message


def crossing(message):
    """Bytes of a message as they cross."""
    return b"".join(bytes(part) for part in message.parts())


def framed(head, numbers=b"", length=None):
    """Bytes of a message whose head is any bytes, and says any length."""
    return LENGTH.pack(len(head) if length is None else length) + head + numbers


INVENTED = {
    "statistic": {"family": "bias", "entries": ["x"], "controlled": False, "unit": "1"},
    "value": 0.0,
    "standard_error": 1e-9,
    "n": 100_000,
    "prediction": 0.0,
    "predictor": "no bias",
    "remainder": 0.0,
    "check": "plain",
}
"""A row that nothing measured, and that would pass."""

ODD = (None, True, -1, 10**400, 0.5, "x", "\udcff", [], [[]], {}, [INVENTED])


def of_words(honest):
    """Words left out, added, or of another kind; rows instead of answers."""
    yield from (
        {k: v for k, v in honest.words.items() if k != left} for left in honest.words
    )
    for name in ("rows", "n", "value", "standard_error", "prediction", "remainder"):
        yield {**honest.words, name: INVENTED.get(name, [INVENTED])}
    yield {"rows": [INVENTED], "estimate": [], "times": {}}
    for name in honest.words:
        yield from ({**honest.words, name: odd} for odd in ODD)
    yield {"error": "no"}
    yield {"error": ["no"], "kind": ["refused"]}


def of_arrays(honest):
    """Arrays left out, added, under another name, or of another shape."""
    for name, own in honest.arrays.items():
        rest = {k: v for k, v in honest.arrays.items() if k != name}
        yield rest
        yield {**rest, f"{name} ": own}
        yield {**honest.arrays, "n": np.array(1e5)}
        yield {**honest.arrays, "rows": own}
        for other in (
            own[None],
            np.ravel(own) if own.ndim != 1 else own[:, None],
            own[..., None],
            own[:-1] if own.ndim else np.empty(0),
            np.concatenate([own, own]) if own.ndim else np.array([own, own]),
            own[:0] if own.ndim else np.empty((0, 3)),
            np.array(0.0) if own.ndim else np.zeros((2, 2)),
            np.zeros((1,) * 8),
        ):
            yield {**rest, name: other}


def of_bytes(honest):
    """No message at all, or one that ends too soon or says that it is greater."""
    whole = crossing(honest)
    for cut in sorted({0, 1, 7, 8, 9, len(whole) // 2, len(whole) - 1}):
        yield whole[:cut]
    head = json.dumps({"words": dict(honest.words), "shapes": {}}).encode()
    for length in (0, len(head) - 1, 1 << 21, 1 << 40, (1 << 64) - 1):
        yield framed(head, length=length)
    for text in (b"", b"{}", b"[]", b"3", b"null", b"\xff\xfe", b"{", b"[" * 10**5):
        yield framed(text)
    yield framed(pickle.dumps(dict(honest.words)))
    yield pickle.dumps(honest.words)
    yield json.dumps({"rows": [INVENTED]}).encode() * 50
    name = next(iter(honest.arrays), "attitudes")
    for shape in ([-1], [1.5], ["3"], [True], [1 << 60], [1 << 47], 3, None, [[1]]):
        yield framed(json.dumps({"words": {}, "shapes": {name: shape}}).encode())
    yield framed(json.dumps({"words": {}, "shapes": {name: [1] * 9}}).encode())
    yield framed(json.dumps({"words": {}, "shapes": {name: [1 << 26, 1]}}).encode())
    yield framed(json.dumps({"words": {}, "shapes": {}, "rows": [INVENTED]}).encode())


def lies(honest):
    """Bytes of all lies."""
    for words in of_words(honest):
        yield crossing(Message(words=words, arrays=honest.arrays))
    for arrays in of_arrays(honest):
        yield crossing(Message(words=honest.words, arrays=arrays))
    yield from of_bytes(honest)
