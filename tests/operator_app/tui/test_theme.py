"""Characters of an ASCII terminal."""

from operator_app.tui.theme import look


def test_ascii_theme_replaces_special_characters():
    plain = look("sarcal-dark", ascii_only=True)
    assert plain.text("placement ±5 mm") == "placement +-5 mm"
    assert plain.text("✗ excluded · ✕ \N{MINUS SIGN}1") == "x excluded . x -1"
