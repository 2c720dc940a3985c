"""What each command is called with: its options, its arguments and its help.

These modules import click, `simval.cli.options` and `simval.vocabulary` alone
(`tests/test_quick_help.py`); a command's function loads the module that does the work.
"""
