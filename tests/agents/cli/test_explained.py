"""Options as `--help` shows them: whole paragraphs, short types, no `None`."""

import pytest

from agents.cli.main import COMMANDS, main


def help_of(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    try:
        assert main([command, "--help"]) == 0  # train goes on to the hyper-parameters
    except SystemExit as end:
        assert end.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_options_that_need_not_be_given_show_no_none(command, capsys, monkeypatch):
    text = help_of(command, capsys, monkeypatch)
    assert "{None}" not in text
    assert "(default: )" not in text
    assert "(default: None)" not in text


def test_texts_types_and_defaults(capsys, monkeypatch):
    text = " ".join(help_of("train", capsys, monkeypatch).split())
    assert "--out PATH Folder that the runs are written to" in text
    assert "--seeds INT ... One run for each seed. (default: 0 1 2)" in text
    assert "--device {cpu,cuda} Where updates run: cuda on a GPU. (default: cpu)" in text
    lines = help_of("train", capsys, monkeypatch).splitlines()
    (line,) = (line for line in lines if "each of which leaves the policy too" in line)
    assert "too; by default there is none but that at the end." in line
    render = " ".join(help_of("render", capsys, monkeypatch).split())
    assert "is a policy that comes with the package. (required)" in render


def test_options_within_options(capsys, monkeypatch):
    text = " ".join(help_of("scene", capsys, monkeypatch).split())
    assert "--optima-perturbation FLOAT FLOAT" in text
    assert "--constraint-radius FLOAT Radius R of the circular cost region. (default: 10.0)" in text
    assert "Raises TypeError" not in text


def test_a_shared_hyper_parameter_has_the_preset_of_those_that_share_it(capsys, monkeypatch):
    """SAC-LB-Streak's random actions have an exponent, 2, and a text of its own."""
    text = help_of("train", capsys, monkeypatch)
    assert "  --random-exponent (0.0): Exponent β of the random actions' power" in text
    assert "  --random-exponent (2.0): Exponent β of the random actions' power" in text
