"""Biopython's superimposers: `SVDSuperimposer`, and `QCPSuperimposer` by Newton.

Both rotate the second set by a matrix to the right of its rows.
"""

from adapting import mirrored, needed

from simval.plugins import Estimator

with needed():
    from Bio import SVDSuperimposer as svd
with needed():
    from Bio.PDB import qcprot as qcp


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
    name="SVD", estimate=_rotation(svd.SVDSuperimposer), **WAHBA
)
qcp_superimposer = Estimator(
    name="QCP", estimate=_rotation(qcp.QCPSuperimposer), **WAHBA
)
