"""Biopython's superimposers: `SVDSuperimposer`, and `QCPSuperimposer` by Newton.

Both rotate the second set by a matrix to the right of its rows.
"""

from packages import mirrored, package

from simval.plugins import Estimator

svd = package("Bio.SVDSuperimposer")
qcp = package("Bio.PDB.qcprot")


def _rotation(superimposer):
    def estimate(body, references):
        found = superimposer()
        found.set(mirrored(body), mirrored(references))
        found.run()
        return found.get_rotran()[0]

    return estimate


WAHBA = {
    "components": "matrix",
    "matrix": "passive",
    "kind": "wahba",
    "takes": "vectors",
    "batch": False,
}

svd_superimposer = Estimator(
    name="Biopython SVD", estimate=_rotation(svd.SVDSuperimposer), **WAHBA
)
qcp_superimposer = Estimator(
    name="Biopython QCP", estimate=_rotation(qcp.QCPSuperimposer), **WAHBA
)
