"""Vectors and the rows of columns: what is done to all of their numbers, one after the other.

add: to + factor x; multiple: factor x; ratio: x / divisor; divide: a vector and the first rows of a
column, by one number.
"""

from vibroscreen.compiler.language import kernel


@kernel
def fill(x, value):
    for i in range(x.size):
        x[i] = value


@kernel
def copy(to, x):
    for i in range(to.size):
        to[i] = x[i]


@kernel
def add(to, factor, x):
    for i in range(to.size):
        to[i] += factor * x[i]


@kernel
def multiple(to, factor, x):
    for i in range(to.size):
        to[i] = factor * x[i]


@kernel
def ratio(to, x, divisor):
    for i in range(to.size):
        to[i] = x[i] / divisor


@kernel
def total(x):
    whole = 0.0
    for i in range(x.size):
        whole += x[i]
    return whole


@kernel
def clear_rows(load, start, stop):
    for j in range(start, stop):
        for i in range(load.shape[1]):
            load[j, i] = 0.0


@kernel
def copy_rows(to, load, rows):
    for j in range(rows):
        for i in range(load.shape[1]):
            to[j, i] = load[j, i]


@kernel
def add_rows(to, factor, load, rows):
    for j in range(rows):
        for i in range(to.size):
            to[i] += factor * load[j, i]


@kernel
def divide(fed, load, rows, divisor):
    for i in range(fed.size):
        fed[i] /= divisor
    for j in range(rows):
        for i in range(fed.size):
            load[j, i] /= divisor
