"""A D-H chain as a pinocchio model: every entry of the table is a joint of its own. Tests only."""

import numpy as np
import pinocchio as pin


class PinocchioChain:
    """``Rz(theta) Tz(s) Tx(a) Rx(alpha) Ry(beta)`` per link: joint Jacobians are Jacobians of the table."""

    def __init__(self, links: int) -> None:
        self.links = links
        self.model = pin.Model()
        parent = 0
        here = pin.SE3.Identity()
        for link in range(links):
            for kind, joint in enumerate(
                (
                    pin.JointModelRZ(),
                    pin.JointModelPZ(),
                    pin.JointModelPX(),
                    pin.JointModelRX(),
                    pin.JointModelRY(),
                )
            ):
                parent = self.model.addJoint(parent, joint, here, f"link_{link}_{kind}")
        self.end = self.model.addFrame(pin.Frame("end", parent, here, pin.FrameType.OP_FRAME))
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
        J = pin.computeFrameJacobian(
            self.model,
            self.data,
            self.q_of(theta, s, a, alpha, beta),
            self.end,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return np.concatenate((J[3:], J[:3])).reshape(6, self.links, 5).swapaxes(1, 2)

    def q_of(self, theta, s, a, alpha, beta=None):
        """Positions of all joints of one pose."""
        beta = np.zeros_like(theta) if beta is None else beta
        return np.stack((theta, s, a, alpha, beta), -1).reshape(-1)
