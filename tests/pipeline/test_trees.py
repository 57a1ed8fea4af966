"""The scene tree of a run: one file that each step replaces, with the earlier ones in history/."""

from neoworld_mjx.config import Config
from neoworld_mjx.pipeline.compose_step import _unfitted
from neoworld_mjx.pipeline.object_steps import _correct_sizes
from neoworld_mjx.pipeline.step_context import RESPONSE_TREE, read_tree, write_files
from neoworld_mjx.run_folder import RunFolder
from tests.support import answers


def test_corrected_sizes_are_in_the_tree_and_in_the_unfitted_tree(tmp_path):
    response = answers.exact()
    first, second, *_ = (node.name for node in response.nodes)
    fitted = response.with_sizes({first: (0.5, 0.6, 0.7), second: (0.1, 0.2, 0.3)})
    with RunFolder(tmp_path / "run", Config()) as run:
        with run.step("parse", {}) as out:
            (out / RESPONSE_TREE).parent.mkdir(parents=True)
            (out / RESPONSE_TREE).write_text(response.to_json())
            (out / "tree.json").write_text(fitted.to_json())
        for node in fitted.nodes:
            with run.step(f"program/{node.name}", {}) as out:
                size = [0.4, 0.4, 0.4] if node.name == first else None
                write_files(out, {f"objects/{node.name}/program.json": {"size": size}})
        _correct_sizes(run, fitted)
        assert read_tree(run, before="program") == fitted
        current = read_tree(run)
        assert current == read_tree(run, before="compose")
        assert current == fitted.with_sizes({first: (0.4, 0.4, 0.4)})
        # The second fit starts from the response; only sizes that models corrected are kept.
        assert _unfitted(run, current) == response.with_sizes({first: (0.4, 0.4, 0.4)})
