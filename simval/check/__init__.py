"""Check of a single plug-in within seconds: two cells, judged by the gate's rules.

`check_plugin` takes what a command line names and measures it as a sweep does, in a run
folder that goes again; `check_function` takes a function that only this process has.
Both answer with a `Checked`: the gate's result, what the plug-ins declare, and its
account.
"""

from simval.check.measure import Checked, check_function, check_plugin

__all__ = ["Checked", "check_function", "check_plugin"]
