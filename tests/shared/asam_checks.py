"""What an ASAM checker says of files, as JSON: for each file, for each check.

    python tests/shared/asam_checks.py qc_opendrive FILE...
    python tests/shared/asam_checks.py qc_openscenario FILE...

runs where the package asam-qc-opendrive or asam-qc-openscenarioxml is installed. The first wants
numpy 1, so the tests give each an environment of its own instead of holding ours to that.
"""

from __future__ import annotations

import json
import logging
import sys
from importlib import import_module
from typing import Any

from qc_baselib import Configuration, Result


def check(checker: str, path: str) -> dict[str, list[str]]:
    """Name of each check -> its status and the issues that it found."""
    constants: Any = import_module(f"{checker}.constants")
    config = Configuration()
    config.set_config_param("InputFile", path)
    result = Result()
    result.register_checker_bundle(
        name=constants.BUNDLE_NAME, description="", version=constants.BUNDLE_VERSION, summary=""
    )
    import_module(f"{checker}.main").run_checks(config, result)
    return {
        one.checker_id: [one.status.value, *(issue.description for issue in one.issues)]
        for one in result.get_checker_results(constants.BUNDLE_NAME)
    }


if __name__ == "__main__":
    logging.disable()
    checker, *files = sys.argv[1:]
    json.dump({path: check(checker, path) for path in files}, sys.stdout)
