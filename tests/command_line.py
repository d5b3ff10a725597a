"""Commands that are refused."""

from jaxalign.cli.main import main


def refused(capsys, arguments):
    """The one line of a user error; nothing on standard output but what was printed before it was found."""
    assert main([str(a) for a in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("jaxalign: error: ")
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err
