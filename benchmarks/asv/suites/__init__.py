"""Suites of airspeed velocity: the time and the memory of each stage, commit by commit.

    asv run --config benchmarks/asv/asv.conf.json --python=same --quick   # what is installed
    asv continuous --config benchmarks/asv/asv.conf.json main HEAD        # two commits

What is compiled at first use is compiled while they are set up.
"""
