"""Page of an audit: its answers, and each term with what is allowed."""

from simval import __version__
from simval.imu.audit import Audit
from simval.report.section import made, template
from simval.report.table import Column, Table


def audit_page(found: Audit) -> str:
    """Render an audit as HTML; the same audit gives the same bytes."""
    account = found.account
    table = Table(
        name="terms",
        caption="Each term: how far it is off what is right, and what is allowed",
        columns=(
            Column("sensor"), Column("term"), Column("axis", "code"),
            Column("off by", "measured"), Column("allowed", "number", 2),
            Column("unit"), Column("answer"),
        ),
        rows=[
            (sensor.name, item.term.title, axis if len(item.value) > 1 else "", (v, sd),
             allowed, item.term.unit,
             "wrong" if item.wrong else "right" if ok else "not judged")
            for sensor in found.sensors
            for item in sensor.items.values()
            for axis, v, sd, allowed, ok in zip(
                "xyzuvwrs", item.value.tolist(), item.sd.tolist(),
                item.allowed.tolist(), item.judged.tolist(), strict=False,
            )
        ],
    )  # fmt: skip
    first = made(
        tables=[table], replies=account.replies, warnings=account.warnings, notes=()
    )
    return template("page").render(
        title=account.name, sections=(first.under("result", "Result"),),
        version=__version__, source=f"the recording {account.source}",
    )  # fmt: skip
