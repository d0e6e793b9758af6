# Short names for what CONTRIBUTING.md explains; `just` lists them. Each runs in the active virtual environment.
set positional-arguments

_list:
    @just --list --unsorted

# install the package, editable, and everything that its tests need
setup:
    python -m pip install -e '.[test]'

# lint and types, then tests that compile nothing: after every edit
fast:
    ruff check .
    mypy
    pytest -q tests/test_units.py tests/test_spec.py tests/test_plan.py tests/test_registry.py tests/test_scenarios.py

# every test that needs only pip: before every commit
test *args:
    pytest "$@"

# tests that ask PrusaSlicer, admesh, rs274 and Chromium
tools *args:
    pytest -m tools "$@"

# every spec at full size
sweep *args:
    pytest -m sweep "$@"

# lint, layout, types, import layers
lint:
    ruff check .
    ruff format --check magiclens
    mypy
    lint-imports

# draw the architecture anew, then check the documentation
docs:
    python docs/draw_architecture.py
    python docs/draw_optics.py
    pytest -q tests/test_docs.py

# the web site: every page of documentation, and small lenses to touch, in out/gallery
site:
    mlens gallery --quick
