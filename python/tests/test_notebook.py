"""The notebook runs, and says what its cells claim: each code cell in turn, without a notebook server."""

import json
import os
import pathlib
import unittest

os.environ.setdefault("MPLBACKEND", "Agg")


class Notebook(unittest.TestCase):
    def test_comparison(self):
        notebook = json.loads((pathlib.Path(__file__).parents[1] / "comparison.ipynb").read_text())
        names = {}
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
        self.assertEqual(set(names["runs"]), {"A", "B", "C", "D", "hybrid"})


if __name__ == "__main__":
    unittest.main()
