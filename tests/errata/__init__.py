"""The sources' claims, each evaluated; entered here in the order of the texts."""
# ruff: noqa: F401, I001

import errata.triangular
import errata.symmetric
import errata.symmetric_update
import errata.estimator
import errata.singular
import errata.case_d
import errata.turns
import errata.errors
import errata.expansions
import errata.moments
import errata.covariances
import errata.gaussian
import errata.terms
import errata.tables
