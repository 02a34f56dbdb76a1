"""Gravity of a D-H chain whose links have masses, by pinocchio. Tests only."""

import numpy as np
import pinocchio as pin

from tests.oracles.pinocchio_chain import PinocchioChain


class PinocchioGravity:
    """Torque that holds a D-H chain up; a link's mass hangs where its joint turns."""

    def __init__(self, mass, centre, gravity) -> None:
        self.chain = PinocchioChain(len(mass))
        model = self.chain.model
        for link, (m, c) in enumerate(zip(mass, centre, strict=True)):
            inertia = pin.Inertia(float(m), np.asarray(c), np.zeros((3, 3)))
            model.appendBodyToJoint(5 * link + 1, inertia, pin.SE3.Identity())
        model.gravity.linear = np.asarray(gravity)
        self.data = model.createData()

    def _q(self, theta, s, a, alpha):
        return np.stack((theta, s, a, alpha, np.zeros_like(theta)), -1).reshape(-1)

    def holding_torque(self, theta, s, a, alpha):
        """Torque (links,) about every joint of one pose, N m."""
        model = self.chain.model
        return pin.computeGeneralizedGravity(model, self.data, self._q(theta, s, a, alpha))[::5]

    def energy(self, theta, s, a, alpha):
        """Potential energy of one pose, J."""
        return pin.computePotentialEnergy(self.chain.model, self.data, self._q(theta, s, a, alpha))
