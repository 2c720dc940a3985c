"""The sources' claims, each evaluated; entered here in the order of the texts."""
# ruff: noqa: F401, I001

import errata.triangular
import errata.symmetric
import errata.estimator
import errata.singular
import errata.errors
import errata.moments
import errata.theorem
import errata.optimum
import errata.terms
import errata.tables
