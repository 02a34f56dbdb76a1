"""A D-H chain as a pinocchio model, with a joint for every entry of the table, and its gravity torques."""

import numpy as np
import pinocchio as pin


class PinocchioChain:
    """``Rz(theta) Tz(s) Tx(a) Rx(alpha) Ry(beta)`` per link: joint Jacobians are those of the table."""

    def __init__(self, links: int) -> None:
        self.links = links
        self.model = pin.Model()
        parent = 0
        identity = pin.SE3.Identity()
        for link in range(links):
            for kind in ("RZ", "PZ", "PX", "RX", "RY"):
                joint = getattr(pin, f"JointModel{kind}")()
                parent = self.model.addJoint(parent, joint, identity, f"link_{link}_{kind}")
        self.end = self.model.addFrame(pin.Frame("end", parent, identity, pin.FrameType.OP_FRAME))
        self.data = self.model.createData()

    def frames(self, theta, s, a, alpha, beta=None):
        """Rotations (links + 1, 3, 3) and origins (links + 1, 3) of all frames of one pose."""
        pin.forwardKinematics(self.model, self.data, self.q_of(theta, s, a, alpha, beta))
        placements = [self.data.oMi[5 * (k + 1)] for k in range(self.links)]
        return (
            np.stack([np.eye(3), *(T.rotation for T in placements)]),
            np.stack([np.zeros(3), *(T.translation for T in placements)]),
        )

    def jacobian(self, theta, s, a, alpha, beta=None):
        """(6, 5, links): rotation over translation of the end point, in the first frame's axes."""
        q, axes = self.q_of(theta, s, a, alpha, beta), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.computeFrameJacobian(self.model, self.data, q, self.end, axes)
        return np.concatenate((J[3:], J[:3])).reshape(6, self.links, 5).swapaxes(1, 2)

    def q_of(self, theta, s, a, alpha, beta=None):
        """Positions of all joints of one pose."""
        beta = np.zeros_like(theta) if beta is None else beta
        return np.stack((theta, s, a, alpha, beta), -1).reshape(-1)


class PinocchioGravity:
    """A D-H chain with a mass on each link, given in the frame after the joint's rotation."""

    def __init__(self, mass, centre, gravity) -> None:
        self.chain = PinocchioChain(len(mass))
        model = self.chain.model
        for link, (m, c) in enumerate(zip(mass, centre, strict=True)):
            inertia = pin.Inertia(float(m), np.asarray(c), np.zeros((3, 3)))
            model.appendBodyToJoint(5 * link + 1, inertia, pin.SE3.Identity())
        model.gravity.linear = np.asarray(gravity)
        self.data = model.createData()

    def holding_torque(self, theta, s, a, alpha):
        q = self.chain.q_of(theta, s, a, alpha)
        return pin.computeGeneralizedGravity(self.chain.model, self.data, q)[::5]
