"""Tables of a sweep."""

from neoworld_mjx.sweeps.result import text_table


def test_shares_have_a_digit_and_other_columns_their_units():
    rate = {"mean": 0.625, "low": 0.2449, "high": 0.9148, "n": 8}
    error = {"mean": 0.01234, "low": 0.01, "high": 0.02, "n": 8}
    point = {"point": "base", "n": 8, "scenes": 8, "passed": rate, "xy_error_m": error}
    table = text_table("", [point]).markdown()
    assert "passed, %" in table and "62.5 [24.5, 91.5]" in table
    assert "xy error, mm" in table and "12.3 [10.0, 20.0]" in table
