"""What the ASAM checker says of OpenSCENARIO files, as JSON: for each file, for each check.

    python tests/export/openscenario_checks.py FILE...

runs where the package asam-qc-openscenarioxml is installed, which the tests give an environment of
its own.
"""

from __future__ import annotations

import json
import logging
import sys

from qc_baselib import Configuration, Result
from qc_openscenario import constants
from qc_openscenario.main import run_checks


def check(path: str) -> dict[str, list[str]]:
    """Name of each check -> its status and the issues that it found."""
    config = Configuration()
    config.set_config_param("InputFile", path)
    result = Result()
    result.register_checker_bundle(
        name=constants.BUNDLE_NAME, description="", version=constants.BUNDLE_VERSION, summary=""
    )
    run_checks(config, result)
    return {
        checker.checker_id: [checker.status.value, *(issue.description for issue in checker.issues)]
        for checker in result.get_checker_results(constants.BUNDLE_NAME)
    }


if __name__ == "__main__":
    logging.disable()
    json.dump({path: check(path) for path in sys.argv[1:]}, sys.stdout)
