"""What a terminal of ASCII characters shows."""

from operator_app.tui.theme import look


def test_ascii_is_ascii_and_every_mark_is_told_from_a_question():
    plain = look("sarcal-dark", ascii_only=True)
    assert plain.text("placement ±5 mm") == "placement +-5 mm"
    assert plain.text("✗ excluded · ✕ \N{MINUS SIGN}1") == "x excluded . x -1"
