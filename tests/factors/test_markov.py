"""Time-stamped readings against Gaussian-process regression with dense covariances."""

from __future__ import annotations

import numpy as np
import pytest

from factors.markov import Matern, WhiteAcceleration, behind, between, beyond, remembered

H_POSITION, H_VELOCITY = np.eye(2, 4), np.eye(2, 4, k=2)


def covariance(process, times, first):
    """Of the states at times (n,) ≥ 0, shape (4n, 4n); `first` is that of the state at 0."""
    blocks = [[np.zeros((4, 4))] * len(times) for _ in times]
    for i, s in enumerate(times):
        A, Q = process.step(s)
        at_s = A @ first @ A.T + Q
        for j, t in enumerate(times):
            if t >= s:
                block = at_s @ process.step(t - s)[0].T
                blocks[i][j], blocks[j][i] = block, block.T
    return np.block(blocks)


PROCESSES = [WhiteAcceleration(0.7), Matern(0.8, 2.5)]


def data(rng, count):
    H = [H_POSITION if rng.random() < 0.5 else H_VELOCITY for _ in range(count)]
    R = [np.diag(rng.uniform(0.01, 0.5, 2)) + 0.005 for _ in range(count)]
    return H, R, [rng.normal(size=2) for _ in range(count)]


def block_diagonal(blocks):
    S = np.zeros((2 * len(blocks),) * 2)
    for i, block in enumerate(blocks):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = block
    return S


@pytest.mark.parametrize("process", PROCESSES, ids=["wnoa", "matern"])
@pytest.mark.parametrize("seed", range(4))
def test_readings_between_two_states_are_the_dense_regression(process, seed):
    rng = np.random.default_rng(seed)
    dt, n = 0.4, 5
    tau = np.sort(rng.uniform(0, dt, n))
    tau[0], tau[-1] = 0.0, dt
    H, R, _ = data(rng, n)
    seen = between(process, dt, tau, H, R)
    first = np.diag([0.5, 0.6, 0.7, 0.8])
    C = covariance(process, [0.0, *tau, dt], first)
    ends, inside = np.r_[0:4, 4 * (n + 1) : 4 * (n + 2)], slice(4, 4 * (n + 1))
    Hs = np.zeros((2 * n, 4 * n))
    for j, h in enumerate(H):
        Hs[2 * j : 2 * j + 2, 4 * j : 4 * j + 4] = h
    # Regression of the readings on the two states.
    gain = Hs @ np.linalg.solve(C[np.ix_(ends, ends)], C[ends, inside]).T
    rest = C[inside, inside] - C[inside][:, ends] @ np.linalg.solve(
        C[np.ix_(ends, ends)], C[ends, inside]
    )
    np.testing.assert_allclose(np.hstack(seen.weights), gain, atol=1e-9)
    np.testing.assert_allclose(seen.covariance, Hs @ rest @ Hs.T + block_diagonal(R), atol=1e-9)


@pytest.mark.parametrize("process", PROCESSES, ids=["wnoa", "matern"])
def test_readings_beyond_the_last_state(process):
    rng = np.random.default_rng(1)
    tau = np.array([0.0, 0.3, 1.7])
    H, R, _ = data(rng, 3)
    seen = beyond(process, tau, H, R)
    given_exactly = covariance(process, tau, np.zeros((4, 4)))
    Hs = np.zeros((6, 12))
    for j, h in enumerate(H):
        Hs[2 * j : 2 * j + 2, 4 * j : 4 * j + 4] = h
        np.testing.assert_allclose(seen.weights[0][2 * j : 2 * j + 2], h @ process.step(tau[j])[0])
    np.testing.assert_allclose(
        seen.covariance, Hs @ given_exactly @ Hs.T + block_diagonal(R), atol=1e-12
    )


@pytest.mark.parametrize("process", PROCESSES, ids=["wnoa", "matern"])
def test_readings_before_a_state_are_the_dense_regression(process):
    """Where nothing is known before data, a first state that is as good as free."""
    rng = np.random.default_rng(1)
    ages = np.array([0.3, 1.7, 0.0])
    H, R, _ = data(rng, 3)
    seen = behind(process, ages, H, R)
    first = 1e5 * np.eye(4) if process.stationary is None else process.stationary
    order = np.argsort(-ages)
    C = covariance(process, [*(1.7 - ages[order]), 1.7], first)
    Hs = np.zeros((6, 16))
    for row, j in enumerate(order):
        Hs[2 * j : 2 * j + 2, 4 * row : 4 * row + 4] = H[j]
    P = C[-4:, -4:]
    gain = Hs @ C[:, -4:] @ np.linalg.inv(P)
    np.testing.assert_allclose(seen.weights[0], gain, atol=1e-4)
    rest = Hs @ C @ Hs.T - gain @ P @ gain.T + block_diagonal(R)
    np.testing.assert_allclose(seen.covariance, rest, atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_memory_is_the_dense_posterior_and_evidence(seed):
    """p(x_0 | past) and p(past), in any order of arrival, simultaneous readings among them."""
    rng = np.random.default_rng(seed)
    process, n = Matern(0.8, 2.5), 7
    ages = rng.uniform(0, 4, n)
    ages[2], ages[3] = ages[5], 0.0
    H, R, z = data(rng, n)
    order = np.argsort(-ages)
    oldest = ages[order[0]]
    C = covariance(process, [*(oldest - ages[order]), oldest], process.stationary)
    Hs = np.zeros((2 * n, 4 * (n + 1)))
    for row, j in enumerate(order):
        Hs[2 * row : 2 * row + 2, 4 * row : 4 * row + 4] = H[j]
    S = Hs @ C @ Hs.T + block_diagonal([R[j] for j in order])
    y = np.concatenate([z[j] for j in order])
    mean = (C @ Hs.T @ np.linalg.solve(S, y))[-4:]
    posterior = (C - C @ Hs.T @ np.linalg.solve(S, Hs @ C))[-4:, -4:]
    energy = 0.5 * y @ np.linalg.solve(S, y)

    shuffled = rng.permutation(n)
    versions = np.stack([np.concatenate([z[j] for j in shuffled]), np.zeros(2 * n)], axis=1)
    memory = remembered(
        process, ages[shuffled], [H[j] for j in shuffled], versions, [R[j] for j in shuffled]
    )
    information = memory.A.T @ memory.A
    np.testing.assert_allclose(np.linalg.inv(information), posterior, atol=1e-10)
    found = np.linalg.solve(information, memory.A.T @ memory.b[:, 0])
    np.testing.assert_allclose(found, mean, atol=1e-10)
    # −log p(x_0, past) = energy + ½‖A x_0 − b‖², so what is left over is the evidence.
    assert memory.energy[0] == pytest.approx(energy, abs=1e-9)
    assert memory.energy[1] == pytest.approx(0, abs=1e-12)


def test_memory_without_a_prior_knows_what_it_was_told_and_no_more():
    """One velocity leaves the position free; a position then fixes it."""
    process = WhiteAcceleration(0.5)
    z, R = np.array([[0.3], [-0.2]]), [0.04 * np.eye(2)]
    told = remembered(process, [1.0], [H_VELOCITY], z, R)
    assert np.linalg.matrix_rank(told.A, tol=1e-9) == 2
    assert told.energy == pytest.approx(0, abs=1e-12)
    both = remembered(process, [1.0, 0.2], [H_VELOCITY, H_POSITION], np.vstack([z, z]), R * 2)
    assert np.linalg.matrix_rank(both.A, tol=1e-9) == 4


def test_memory_fades_as_the_process_forgets():
    process = Matern(0.5, 1.0)

    def mean(age):
        z, R = np.array([[1.0], [0.0]]), [0.01 * np.eye(2)]
        memory = remembered(process, [age], [H_POSITION], z, R)
        return np.linalg.solve(memory.A, memory.b[:, 0])[0]

    means = [mean(age) for age in (0.0, 0.5, 1.0, 2.0, 5.0, 40.0)]
    assert np.all(np.diff(means) < 0)
    k = 0.25 * (1 + np.sqrt(3) * 2.0) * np.exp(-np.sqrt(3) * 2.0)
    assert means[3] == pytest.approx(k / (0.25 + 0.01), abs=1e-12)
    assert means[-1] == pytest.approx(0, abs=1e-12)
