# Two commands do all set-up: `make run` (the main job) and `make test` (the tests).
# PYTHON may name another interpreter: make test PYTHON=python3.12
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
WORKERS ?= 2
# of pytest: make test-slow ARGS=--times
ARGS ?=

.PHONY: help run test test-times test-slow test-all lint types bench tables clean

help:
	@echo "make run       set up, study seven methods over 1000 simulated runs with outliers: a table, out/dvl-sturn/"
	@echo "make test      set up, run the tests (not those marked slow or exact)"
	@echo "make test-slow the others;  make test-all  both"
	@echo "make test-times the tests of make test, with the CPU seconds of every file and room"
	@echo "make lint      ruff (check and format)        make types     pyright"
	@echo "make bench     speed and memory into benchmarks/*.md"
	@echo "make tables    the tables of experiments/, about an hour (two need the logs: JAXALIGN_SHARED=folder)"
	@echo "make clean     remove what the above have made, but the environment"

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "jaxalign needs Python 3.11 or newer: make $(MAKECMDGOALS) PYTHON=python3.12"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

run: $(STAMP)
	rm -rf out/dvl-sturn
	$(BIN)/jaxalign study dvl-sturn --set outliers=fixed --methods oba,roba,moba,rkf_oba,centred_oba,revising_oba,robust_map \
		--runs 1000 --every 20 --output out/dvl-sturn --plot

test: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadscope -m "not slow and not exact" --optimise none $(ARGS)

test-times: ARGS += --times
test-times: test

test-slow: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadscope -m "exact or long" --optimise less $(ARGS)
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadscope -m "slow and not exact and not long" --optimise none $(ARGS)

test-all: test test-slow

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/pyright

bench: $(STAMP)
	$(BIN)/python -m benchmarks.single
	$(BIN)/python -m benchmarks.prefilter
	$(BIN)/python -m benchmarks.peers
	$(BIN)/python -m benchmarks.scaling
	$(BIN)/python -m benchmarks.tuning
	$(BIN)/python -m benchmarks.robust_map

tables: $(STAMP)
	$(BIN)/python -m experiments.xu2020_rkf_dvl
	$(BIN)/python -m experiments.shen2025_moba_dvl
	$(BIN)/python -m experiments.xu2017_quaternion_kf
	$(BIN)/python -m experiments.huang_vo_tvk_gps
	$(BIN)/python -m experiments.vondrak_disturbed_base
	$(BIN)/python -m experiments.real_logs
	$(BIN)/python -m experiments.tuning
	$(BIN)/python -m experiments.embedding
	$(BIN)/python -m experiments.bound

clean:
	rm -rf out dist .pytest_cache .ruff_cache .hypothesis .benchmarks
