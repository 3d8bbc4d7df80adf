"""The command line's errors about unknown arguments."""

import pytest

from posegsa.cli.command import main

pytestmark = pytest.mark.quick


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tune", "--itertaions=3"], "posegsa tune: error: unrecognized arguments: --itertaions=3"),
        (["evaluate", "run", "--scenraios", "3"], "did you mean --scenarios?"),
        (["tune", "--bogus"], "unrecognized arguments: --bogus\n"),
        (["tune", "quick", "another"], "posegsa tune: error: unrecognized arguments: another\n"),
        (["evaluate", "run", "other", "--scenraios", "3"], "did you mean --scenarios?"),
        (["--versoin", "configs"], "did you mean --version?"),
        (["tun", "quick"], "did you mean tune?"),
        (["export", "run", "--format", "jsn"], "did you mean json?"),
    ],
)
def test_a_command_says_what_it_does_not_know(arguments, said, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
