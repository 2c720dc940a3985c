"""What the three derivations print, held to sympy: right, or misprinted as listed.

``docs/errata.md`` lists every entry marked False here. Text that the
extraction has merely garbled (lost subscripts of labels) is not counted as printed.
"""

import pytest
import sympy as sp

K11, K12, K13, K22, K23, K33 = K = sp.symbols("k11 k12 k13 k22 k23 k33")
B = sp.symbols("b_x b_y b_z")
X, Y, Z = BAR = sp.symbols("x y z")  # reading less bias
A_RAW = sp.symbols("a_x a_y a_z")
PARAMETERS = (*K, *B)


def exact_residual():
    matrix = sp.Matrix([[K11, K12, K13], [K12, K22, K23], [K13, K23, K33]])
    h = matrix * (sp.Matrix(A_RAW) - sp.Matrix(B))
    return (h.T * h)[0]


E_EXACT = exact_residual()
FORM_A = K11**2 + K12**2 + K13**2
FORM_B = K12**2 + K22**2 + K23**2
FORM_C = K13**2 + K23**2 + K33**2
FORM_D = 2 * (K11 * K12 + K12 * K22 + K13 * K23)
FORM_E = 2 * (K12 * K13 + K22 * K23 + K23 * K33)
FORM_F = 2 * (K11 * K13 + K12 * K23 + K13 * K33)


def derivative(*which):
    result = E_EXACT
    for index in which:
        result = sp.diff(result, PARAMETERS[index - 1])
    bar = {a: v + b for a, v, b in zip(A_RAW, BAR, B, strict=True)}
    return sp.expand(result.subs(bar))


def residual_printed(last):
    square = FORM_A * X**2 + FORM_B * Y**2 + FORM_C * Z**2
    return square + FORM_D * X * Y + FORM_E * Y * Z + FORM_F * last


# (derivatives taken, printed right-hand side, is it right)
PRINTED = {
    "e by coefficients": ((), residual_printed(Z * X), True),
    "e written out, last product": ((), residual_printed(Z * Y), False),
    "k11": ((1,), 2 * X * (K11 * X + K12 * Y + K13 * Z), True),
    "k12": (
        (2,),
        2 * (K12 * (X**2 + Y**2) + (K11 + K22) * X * Y + K13 * Y * Z + K23 * Z * X),
        True,
    ),
    "k13": (
        (3,),
        2 * (K13 * (X**2 + Z**2) + K23 * X * Y + K12 * Y * Z + (K11 + K33) * Z * X),
        True,
    ),
    "k22": ((4,), 2 * Y * (K12 * X + K22 * Y + K23 * Z), True),
    "k23": (
        (5,),
        2 * (K23 * (Y**2 + Z**2) + K13 * X * Y + (K22 + K33) * Y * Z + K12 * Z * X),
        True,
    ),
    "k33, printed as x5 and k23": (
        (5,),
        2 * Z * (K13 * X + K23 * Y + K33 * Z),
        False,
    ),
    "k33": ((6,), 2 * Z * (K13 * X + K23 * Y + K33 * Z), True),
    "b_x by coefficients": (
        (7,),
        -2 * (FORM_A * X + FORM_D / 2 * Y + FORM_F / 2 * Z),
        True,
    ),
    "b_x written out, squares lost": (
        (7,),
        -2 * ((K11 + K12 + K12 + K13) * X + FORM_D / 2 * Y + FORM_F / 2 * Z),
        False,
    ),
    "b_y": ((8,), -2 * (FORM_D / 2 * X + FORM_B * Y + FORM_E / 2 * Z), True),
    "b_z by coefficients": (
        (9,),
        -2 * (FORM_F / 2 * X + FORM_E / 2 * Y + FORM_C * Z),
        True,
    ),
    "b_z, printed as b_y": (
        (8,),
        -2 * (FORM_F / 2 * X + FORM_E / 2 * Y + FORM_C * Z),
        False,
    ),
    "b_z written out, last coefficient": (
        (9,),
        -2 * (FORM_F / 2 * X + FORM_E / 2 * Y + (K13 * K22 + K23**2 + K23**2) * Z),
        False,
    ),
    "1 1": ((1, 1), 2 * X**2, True),
    "1 2": ((1, 2), 2 * X * Y, True),
    "1 3": ((1, 3), 2 * Z * X, True),
    "1 3 again, as 0": ((1, 3), sp.Integer(0), False),
    "1 4": ((1, 4), sp.Integer(0), True),
    "1 5": ((1, 5), sp.Integer(0), True),
    "1 6": ((1, 6), sp.Integer(0), True),
    "1 7": ((1, 7), -2 * (2 * K11 * X + K12 * Y + K13 * Z), True),
    "1 8": ((1, 8), -2 * K12 * X, True),
    "1 9": ((1, 9), -2 * K13 * X, True),
    "2 2": ((2, 2), 2 * (X**2 + Y**2), True),
    "2 3": ((2, 3), 2 * Y * Z, True),
    "2 4": ((2, 4), 2 * X * Y, True),
    "2 5": ((2, 5), 2 * Z * X, True),
    "2 5, said to equal 1 2": ((2, 5), 2 * X * Y, False),
    "2 6": ((2, 6), sp.Integer(0), True),
    "2 7": ((2, 7), -2 * (2 * K12 * X + (K11 + K22) * Y + K23 * Z), True),
    "2 8": ((2, 8), -2 * ((K11 + K22) * X + 2 * K12 * Y + K13 * Z), True),
    "2 9": ((2, 9), -2 * (K23 * X + K13 * Y), True),
    "3 3": ((3, 3), 2 * (X**2 + Z**2), True),
    "3 4": ((3, 4), sp.Integer(0), True),
    "3 5": ((3, 5), 2 * X * Y, True),
    "3 5 again, as zx": ((3, 5), 2 * Z * X, False),
    "3 6": ((3, 6), 2 * Z * X, True),
    "3 7": ((3, 7), -2 * (2 * K13 * X + K23 * Y + (K11 + K33) * Z), True),
    "3 8": ((3, 8), -2 * (K23 * X + K12 * Z), True),
    "3 9, a term lost": ((3, 9), -2 * ((K11 + K33) * X + K12 * Y), False),
    "9 3": ((9, 3), -2 * ((K11 + K33) * X + K12 * Y + 2 * K13 * Z), True),
    "4 4": ((4, 4), 2 * Y**2, True),
    "4 5": ((4, 5), 2 * Y * Z, True),
    "4 6": ((4, 6), sp.Integer(0), True),
    "4 7": ((4, 7), -2 * K12 * Y, True),
    "4 8": ((4, 8), -2 * (K12 * X + 2 * K22 * Y + K23 * Z), True),
    "4 9": ((4, 9), -2 * K23 * Y, True),
    "5 5": ((5, 5), 2 * (Y**2 + Z**2), True),
    "5 5 again, as yz": ((5, 5), 2 * Y * Z, False),
    "5 6": ((5, 6), 2 * Y * Z, True),
    "5 7": ((5, 7), -2 * (K13 * Y + K12 * Z), True),
    "5 8": ((5, 8), -2 * (K13 * X + 2 * K23 * Y + (K22 + K33) * Z), True),
    "5 9": ((5, 9), -2 * (K12 * X + (K22 + K33) * Y + 2 * K23 * Z), True),
    "6 6": ((6, 6), 2 * Z**2, True),
    "6 7": ((6, 7), -2 * K13 * Z, True),
    "7 6, a term too many": ((7, 6), -2 * (K13 * Z + K12 * Z), False),
    "6 8": ((6, 8), -2 * K23 * Z, True),
    "6 9": ((6, 9), -2 * (K13 * X + K23 * Y + 2 * K33 * Z), True),
    "6 9, printed as b_y": ((6, 8), -2 * (K13 * X + K23 * Y + 2 * K33 * Z), False),
    "7 7": ((7, 7), 2 * FORM_A, True),
    "7 7 written out": ((7, 7), 2 * (K13 * Z + K12 * Z), False),
    "7 8": ((7, 8), FORM_D, True),
    "7 9": ((7, 9), FORM_F, True),
    "8 8": ((8, 8), 2 * FORM_B, True),
    "8 9": ((8, 9), FORM_E, True),
    "9 9, printed as E": ((9, 9), FORM_E, False),
    "9 9": ((9, 9), 2 * FORM_C, True),
}


@pytest.mark.parametrize("name", PRINTED)
def test_symmetric_derivation(name):
    which, printed, right = PRINTED[name]
    assert (sp.expand(derivative(*which) - printed) == 0) is right


def test_every_second_derivative_has_a_right_entry():
    proved = {tuple(sorted(w)) for w, _, right in PRINTED.values() if right}
    assert {(i, j) for i in range(1, 10) for j in range(i, 10)} <= proved


S_YX, S_ZX, S_ZY, K_X, K_Y, K_Z = T_K = sp.symbols("S_yx S_zx S_zy K_x K_y K_z")
T = sp.Matrix([[1, 0, 0], [S_YX, 1, 0], [-S_ZX, S_ZY, 1]])
OFFSET = sp.Matrix(A_RAW) - sp.Matrix(B)
H = T * sp.diag(K_X, K_Y, K_Z) * OFFSET
TRIANGULAR = (*T_K, *B)


def test_imu_tk_blocks():
    """Matrix blocks of dh/dtheta as defined, and as printed the second time."""
    scaled = sp.diag(K_X, K_Y, K_Z) * OFFSET  # a^s(1)
    shape = sp.Matrix([[0, 0, 0], [scaled[0], 0, 0], [0, -scaled[0], scaled[1]]])
    scale = T * sp.diag(*OFFSET)  # with a^s(2)
    bias = -T * sp.diag(K_X, K_Y, K_Z)
    zero = sp.zeros(3, 9)
    assert (
        sp.expand(H.jacobian(TRIANGULAR) - shape.row_join(scale).row_join(bias)) == zero
    )
    # J_k is printed with one symbol a^s(u) in both blocks: neither choice is right
    for one in (scaled, OFFSET):
        shape = sp.Matrix([[0, 0, 0], [one[0], 0, 0], [0, -one[0], one[1]]])
        both = shape.row_join(T * sp.diag(*one)).row_join(bias)
        assert sp.expand(H.jacobian(TRIANGULAR) - both) != zero


def test_imu_tk_sign():
    """J = -2 h' dh is the derivative of g^2 - h'h."""
    e = -(H.T * H)[0]
    assert sp.expand(
        sp.Matrix([e]).jacobian(TRIANGULAR) + 2 * H.T * H.jacobian(TRIANGULAR)
    ) == sp.zeros(1, 9)


def test_scalar_derivation_defines_S_with_a_diagonal_that_must_be_zero():
    printed = sp.Matrix([[1, 0, 0], [-S_YX, 1, 0], [S_ZX, -S_ZY, 1]])
    assert sp.eye(3) - printed != T
    assert sp.eye(3) - printed + sp.eye(3) == T


A_X, A_Y, A_Z = H
SCALAR = {
    "ax Kx": (A_X, K_X, OFFSET[0]),
    "ax bx": (A_X, B[0], -K_X),
    "ay Syx": (A_Y, S_YX, OFFSET[0] * K_X),
    "ay Kx": (A_Y, K_X, OFFSET[0] * S_YX),
    "ay Ky": (A_Y, K_Y, OFFSET[1]),
    "ay bx": (A_Y, B[0], -K_X * S_YX),
    "ay by": (A_Y, B[1], -K_Y),
    "az Szx": (A_Z, S_ZX, -OFFSET[0] * K_X),
    "az Szy": (A_Z, S_ZY, OFFSET[1] * K_Y),
    "az Kx": (A_Z, K_X, -OFFSET[0] * S_ZX),
    "az Ky": (A_Z, K_Y, OFFSET[1] * S_ZY),
    "az Kz": (A_Z, K_Z, OFFSET[2]),
    "az bx": (A_Z, B[0], K_X * S_ZX),
    "az by": (A_Z, B[1], -K_Y * S_ZY),
    "az bz": (A_Z, B[2], -K_Z),
}


@pytest.mark.parametrize("name", SCALAR)
def test_scalar_derivation(name):
    value, by, printed = SCALAR[name]
    assert sp.expand(sp.diff(value, by) - printed) == 0


def test_the_stop_rule_as_printed_fails_where_a_parameter_is_zero():
    """2 (x - y)/(x + y) at a parameter that crosses zero: it never gets small."""
    x, y = 1e-13, -0.9e-13  # far below any tolerance
    assert abs(2 * (x - y) / (x + y)) > 10
