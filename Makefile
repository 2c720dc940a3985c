# Two commands on a fresh machine: `make report` and `make test`.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: report test landing check nightly power bench sanitize mutants lowest sample league docs clean

report: .venv/core
	@mkdir -p reports/runs
	@run="reports/runs/accuracy-$$(date +%Y%m%d-%H%M%S)"; \
	$(BIN)/simval sweep accuracy --out "$$run" && $(BIN)/simval report "$$run"

# a file's tests stay together, for what they share; one thread for each process; each
# starts many more, so what they compile is kept, though a container may forbid it
PYTEST := env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
  $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test: check
	$(PYTEST) -m "not (ci or slow or wheel or league)"

# meanwhile a wheel is built and installed, which mostly waits
landing: test
	@$(BIN)/python -m pytest -q -m "wheel and not slow" -n 2 & wheel=$$!; \
	$(PYTEST) -m "ci and not slow"; status=$$?; wait $$wheel && exit $$status

# meanwhile the other core compiles the tests, once for all processes of the next step
check: .venv/installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	@$(PYTEST) -n 0 --collect-only -qq >/dev/null & $(BIN)/mypy; status=$$?; wait; exit $$status
	$(BIN)/lint-imports

nightly: check docs sanitize
	-$(MAKE) tests/pages/installed
	HYPOTHESIS_PROFILE=nightly $(BIN)/python -m pytest -m "not league"
	$(MAKE) power POWER=
	$(MAKE) power POWER=--rates
	$(MAKE) mutants
	$(MAKE) .venv-league/installed
	PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 .venv-league/bin/python -m pytest -m league tests/plugins/test_league.py
	$(MAKE) lowest
	$(MAKE) bench

# faults put into the flow, and their clean twins, through the gate: every third of them
POWER ?= --quick
power: .venv/installed
	PYTHONPATH=tests $(BIN)/python -m power $(POWER)

# simval beside the alternatives and the last release: all races, or RACES="calibration
# allan"; RELEASE=yes writes their ratios as the last release's
bench: .venv/installed
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests $(BIN)/python -m benchmarks $(if $(RELEASE),--release) $(RACES)

# the compiled filter under sanitizers, with random arguments
sanitize: .venv/installed
	$(BIN)/python tests/imu/sanitized.py

# axe-core and the Nu HTML checker, which judge the pages; without npm their tests skip
tests/pages/installed: tests/pages/package-lock.json
	npm ci --prefix tests/pages --no-audit --no-fund
	touch $@

# faults put into the code one at a time: a sample of each of these rooms, or ROOMS, COUNT, SEED
ROOMS ?= imu/attitude imu/sensor imu/noise imu/filters judge montecarlo
COUNT ?= 20
SEED ?= 1
mutants: .venv/installed
	$(BIN)/python tests/mutants/sample.py --count $(COUNT) --seed $(SEED) $(ROOMS)

# the committed sample report and the README's figures
sample: .venv/installed
	rm -rf reports/runs/sample
	$(BIN)/simval sweep reports/sample.toml --out reports/runs/sample
	$(BIN)/simval report reports/runs/sample --out reports/sample.html --figures reports/figures \
	  --only orders --only summary-attitude --only summary-calibration --only budget
	rm -rf reports/runs/before reports/runs/after && mkdir -p reports/runs/changed
	sed 's/dt \* self.Q/dt**2 * self.Q/' docs/examples/kalman.py > reports/runs/changed/kalman.py
	$(BIN)/simval sweep reports/worse.toml --out reports/runs/before \
	  --set filter.algorithm=docs/examples/kalman.py
	$(BIN)/simval sweep reports/worse.toml --out reports/runs/after \
	  --set filter.algorithm=reports/runs/changed/kalman.py
	$(BIN)/python docs/examples/worse.py reports/runs/before reports/runs/after reports/figures/worse.svg

# the public packages side by side: the committed report and its facts; a package that is
# refused (3) is what it shows
LEAGUE := docs/examples/league
league: .venv-league/installed
	rm -rf reports/runs/league
	OMP_NUM_THREADS=1 .venv-league/bin/simval sweep $(LEAGUE)/league.toml --out reports/runs/league \
	  || test $$? -eq 3
	rm -rf reports/runs/league-filters
	OMP_NUM_THREADS=1 .venv-league/bin/simval sweep $(LEAGUE)/filters.toml --out reports/runs/league-filters \
	  || test $$? -eq 3
	.venv-league/bin/simval report reports/runs/league --out reports/league.html
	.venv-league/bin/simval report reports/runs/league-filters --out reports/league-filters.html --figures reports/figures --only filter-errors
	.venv-league/bin/python $(LEAGUE)/facts.py reports/runs/league reports/runs/league-filters

.venv-league/installed: pyproject.toml
	test -x .venv-league/bin/python || $(PYTHON) -m venv .venv-league
	.venv-league/bin/python -m pip install --quiet --disable-pip-version-check -e '.[test,league]'
	touch $@

# the documentation as files that open without a server: build/site/index.html; what it
# links to, and what it names, must exist
docs: .venv-docs/installed
	rm -rf build/site build/doctrees
	.venv-docs/bin/python -m sphinx --builder html --fail-on-warning --keep-going --quiet --jobs auto \
	  --conf-dir docs/site --doctree-dir build/doctrees docs build/site
	@echo "build/site/index.html"

.venv-docs/installed: pyproject.toml
	test -x .venv-docs/bin/python || $(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@

# the stated lower bounds, really installed, that of the build too; of what old and new
# packages warn each other of, nothing is asked
lowest:
	rm -rf .venv-lowest && $(PYTHON) -m venv .venv-lowest
	.venv-lowest/bin/python tests/lowest_versions.py > .venv-lowest/bounds.txt
	PIP_CONSTRAINT=.venv-lowest/bounds.txt .venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check -e . -r .venv-lowest/bounds.txt
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv-lowest/bin/python -m pytest -n auto --dist loadfile \
	  -W default::DeprecationWarning -m "not (slow or wheel or league)"

# made when missing, re-used when not; remade only when the dependencies change: what a
# report needs, and with the tests' own packages
.venv/core: EXTRAS :=
.venv/installed: EXTRAS := [test]
.venv/core .venv/installed: pyproject.toml CMakeLists.txt simval/imu/filters/mekf.c
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.$(EXTRAS)'
	touch $@

clean:
	rm -rf .venv .venv-lowest .venv-league .venv-docs docs/reference dist build mutants .mypy_cache .ruff_cache .pytest_cache
