"""What a declaration of a plug-in must be: one rule for each kind of value."""

from typing import Any

from simval.errors import PluginError


def require_name(name: Any) -> None:
    """Refuse what cannot stand in a list of names.

    Raises
    ------
    PluginError
        With what may be declared.
    """
    if not (
        isinstance(name, str)
        and name.isprintable()
        and name == name.strip()
        and "," not in name
        and 0 < len(name) <= 60
    ):
        msg = (
            f"`name` is {name!r}; give a printable word of at most 60 characters, with "
            "no comma in it and no space around it: it is written in lists of names"
        )
        raise PluginError(msg)


def require_words(field: str, names: Any, known: tuple[str, ...]) -> None:
    """Refuse what is not a tuple of known names.

    Raises
    ------
    PluginError
        With what may be declared.
    """
    if not (
        isinstance(names, tuple)
        and all(type(name) is str and name in known for name in names)
    ):
        words = ", ".join(repr(name) for name in known)
        msg = f"`{field}` is {names!r}; it must be a tuple of names out of {words}"
        raise PluginError(msg)


def require_one_of(name: str, value: Any, allowed: tuple[str | int, ...]) -> None:
    """Refuse what is not one of the allowed values, of the very type.

    Raises
    ------
    PluginError
        With what may be declared.
    """
    # of the very type: 2 == 2.0, 1 == True, and an array is equal to nothing at all
    if not any(type(value) is type(word) and value == word for word in allowed):
        words = ", ".join(repr(word) for word in allowed)
        msg = f"`{name}` is {value!r}; it must be declared as one of {words}"
        raise PluginError(msg)


def require_function(name: str, value: Any) -> None:
    """Refuse what cannot be called.

    Raises
    ------
    PluginError
        With what may be declared.
    """
    if not callable(value):
        msg = f"`{name}` is {value!r}; it must be a function"
        raise PluginError(msg)
