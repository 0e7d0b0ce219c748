"""Wrong usage is one line that says what would be right."""

from __future__ import annotations

import pytest

from onboard.__main__ import main


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        (["calibrate", "--size", "banana"], "--size: 'banana' is not two whole numbers as in 640x480"),
        (["calibrate", "--size", "640x0"], "'640x0' is not two"),
        (["calibrate", "--seconds", "soon"], "'soon' is no number of seconds from 0 to 86400"),
        (["replay", "--speed", "fast"], "'fast' is neither 'max' nor a number"),
        (["replay", "--speed", "nan"], "'nan' is neither"),
        (["make-credentials", "keys", "--days", "-1"], "'-1' is no number of days"),
        ([], "required: COMMAND"),
        (["stauts"], "no command 'stauts'; did you mean 'status'?"),
        (["replay", "--sett", "a.b=1"], "unrecognized arguments: --sett; did you mean --set?"),
    ],
)
def test_wrong_usage_is_one_line_without_names_of_ours(
    arguments: list[str], printed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    out, complaint = capsys.readouterr()
    assert (end.value.code, out, complaint.count("\n")) == (2, "", 1)
    assert printed in complaint and "value:" not in complaint


def test_a_replay_without_its_inputs_names_all_that_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "--frames", "somewhere"]) == 2
    assert capsys.readouterr().err.endswith(": --telemetry and --camera missing\n")
