"""jax-sysid: `LinearModel` (discrete time) and `CTModel` (continuous time).

"LinearModel" is the example of its README: penalties 1e-2 on the coefficients and 1e-3 on the
initial state, 1000 evaluations of L-BFGS. The signals are scaled, as it asks for, here by their
root mean squares without removing a mean, because zero is the state of rest.

"tuned": a penalty pulls every coefficient towards zero, so it is all but turned off (1e-8); the
initial state is known to be rest; 1000 steps of Adam come before 2000 evaluations of L-BFGS, as in
its other examples, because without them L-BFGS alone often ends elsewhere.

"CTModel, tuned": `A, B, C` as in its example of a continuous-time linear model, which starts at
``A = -I``, with the penalties off and the start at rest; Heun's method with ten steps a sample and
a held input are the defaults. Release 1.1.0 holds the *next* value of the input between two samples
(`CTModel.input_fcn_gen`), so the input is handed over one sample late.
"""

import os
import sys
from pathlib import Path

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import jax
import numpy as np
from jax_sysid.models import CTModel, LinearModel
from protocol import Task, coefficients, continuous, serve

OFF = 1e-8


def scaled(task: Task) -> tuple[np.ndarray, np.ndarray, float, float]:
    sizes = [float(np.sqrt(np.mean(signal**2))) for signal in (task.y, task.u)]
    return task.y[:, None] / sizes[0], task.u[:, None] / sizes[1], *sizes


def linear(task: Task, *, as_tuned: bool) -> np.ndarray:
    y, u, y_size, u_size = scaled(task)
    model = LinearModel(task.poles, 1, 1, feedthrough=False)
    if as_tuned:
        model.loss(rho_x0=OFF, rho_th=OFF, train_x0=False)
        model.optimization(adam_epochs=1000, lbfgs_epochs=2000, iprint=-1)
    else:
        model.loss(rho_x0=1e-3, rho_th=1e-2)
        model.optimization(adam_epochs=0, lbfgs_epochs=1000, iprint=-1)
    model.fit(y, u)
    a, b, c, d = (np.asarray(matrix) for matrix in model.ssdata())
    return continuous(a, b / u_size, c * y_size, d, task)


@jax.jit
def state_rate(x, u, t, params):
    return params[0] @ x + params[1] @ u


@jax.jit
def output(x, u, t, params):
    return params[2] @ x


def continuous_time(task: Task) -> np.ndarray:
    y, u, y_size, u_size = scaled(task)
    draw = np.random.default_rng(1)
    b, c = 0.1 * draw.standard_normal((task.poles, 1)), 0.1 * draw.standard_normal((1, task.poles))
    model = CTModel(task.poles, 1, 1, state_fcn=state_rate, output_fcn=output)
    model.integration_options()
    model.init(params=[-np.eye(task.poles), b, c])
    model.loss(rho_x0=OFF, rho_th=OFF, train_x0=False)
    model.optimization(adam_epochs=100, lbfgs_epochs=2000, adam_eta=0.1, iprint=-1)
    late = np.vstack([u[:1], u[:-1]])
    model.fit(y, late, task.dt * np.arange(task.u.size))
    f, g, h = (np.asarray(matrix) for matrix in model.params)
    return coefficients(f, g / u_size, h * y_size, 0.0, task)


serve(
    {
        "LinearModel": lambda task: linear(task, as_tuned=False),
        "LinearModel, tuned": lambda task: linear(task, as_tuned=True),
        "CTModel, tuned": continuous_time,
    },
    ("jax-sysid", "jax", "jaxlib", "numpy", "scipy"),
)
