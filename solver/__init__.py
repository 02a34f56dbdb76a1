"""Kinematics, closure, estimation and planning. Uses NumPy and SciPy only, and has no input or output.

Functions for the equations of the paper (Giugovaz and Hollerbach); phi is ``x`` and C = dF/dphi is ``jac_x``:

    eqs. 1, 2      p_c, R_c of the chain           solver.chain.kinematics.forward
    (section 2.1)  theta' = theta + theta_off      solver.loops.arm_loop.ArmLoop.frames
    (section 2.1)  screws: dx for every entry      solver.chain.kinematics.jacobian
    eqs. 3, 4      x_c = f(theta, phi), open arm   solver.loops.endpoints.MeasuredClosure.predicted
    eq. 5          dX = C dphi, all poses          solver.estimators.paper.closure_problem
    eq. 6          dphi = (C'C)^-1 C' dX           solver.estimators.least_squares.Triangle.step
    (section 2.1)  phi = phi_0 + dphi, repeated    solver.estimators.least_squares.solve_damped
    eq. 7          dx = (dr, dp), measured         solver.loops.endpoints.MeasuredClosure.loop
    eqs. 8, 9, 10  closure of a loop, frame -1     solver.loops.dh.DhLoop.loop
    eqs. 11, 12    theta_0 of the hinge            solver.loops.dh.DhLoop.initial_unsensed
    eq. 13         (dx, dy, dp), hinge eliminated  solver.loops.dh.DhLoop.reduced
    eqs. 14, 15    sigma_pos, sigma_ori            solver.loops.closure.closure_sigmas
    (section 3)    scaled condition number [13]    solver.diagnostics.identifiability.identifiability_of_jacobian
    Tables 1, 2    phi in the D-H table            solver.loops.arm_loop.ArmLoop.tables

Beyond the paper: the reduction E' of unsensed joints (`solver.closing.reduced_equations`), noise of the joint
readings (`solver.estimators.implicit.fit_implicit`), choice of poses (`solver.design.plan.make_plan`).
"""
