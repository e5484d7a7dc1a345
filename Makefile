# Habit's door to ./dev, which needs no make.
.PHONY: evaluate test bench docs wheel clean
evaluate test bench docs wheel:
	@./dev $@
clean:
	rm -rf .venv build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name '*.nb[ci]' -not -path './.venv/*' -delete
