import ast
from textwrap import dedent

from tests.mutants import groups, wilson
from tests.support.mutations import draw, mutants


def changed(source: str) -> list[str]:
    """The whole text of each mutant."""
    data = dedent(source).encode()
    return [mutant.apply(data).decode() for mutant in mutants("m.py", data)]


def test_each_operator_changes_one_place():
    source = '''
        def f(x, *, deep=True):
            """Zero 0 ° and one 1."""
            if "µ" in x and not deep:
                x.n += 2.0
                x.close()
            return x.n - 1
    '''
    before = ast.dump(ast.parse(dedent(source)))
    lines = {
        line.strip()
        for text in changed(source)
        for line in set(text.splitlines()) - set(dedent(source).splitlines())
    }
    assert lines == {
        "def f(x, *, deep=False):",
        "if (not ('µ' in x and (not deep))):",
        "if ('µ' in x or not deep):",
        "if ('µ' not in x) and not deep:",
        'if "µ" in x and (deep):',
        "x.n += 2.3000000000000003",
        "pass",
        "return None",
        "return (x.n + 1)",
        "return x.n - 0",
    }
    assert len(changed(source)) == 11
    assert all(ast.dump(ast.parse(text)) != before for text in changed(source))


def test_texts_types_and_assertions_stay():
    assert not changed('''
        """Version 1 > 0."""
        __all__ = ["a" + "b"]
        if TYPE_CHECKING:
            one = 1
        @cached(size=3)
        def f(x: Literal[1], text: str) -> Array["3 2"]:
            """2 > 1."""
            assert x > 1
            logging.info("%d", 1 + x)
            text: Literal[2] = f"{x + 1}" + text
            if_wrong = ValueError(1 + x)
            raise TypeError(f"{x} > {1}")
    ''')


def test_the_same_mutants_are_drawn_again():
    drawn = draw(["measure"], 5, 3)
    assert drawn == draw(["measure"], 5, 3)
    assert len(set(drawn)) == 5


def test_tests_named_after_a_module_run_first():
    first, importing, rest, elsewhere = groups("neoworld_mjx/measure/boxes.py")
    assert first == ["tests/measure/test_boxes.py"]
    assert all(path.startswith("tests/measure/") for path in importing + rest)
    assert not any(path.startswith("tests/measure/") for path in elsewhere)


def test_interval_of_a_share():
    low, high = wilson(90, 100)
    assert round(low, 3) == 0.826 and round(high, 3) == 0.945
