"""Results from a sensor in MuJoCo: the same as from a real one."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, Final

import msgspec
import numpy as np

from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.mjcf.export import NAME, Parameters
from tacshade_edge.lab.mjcf.felt_skin import FeltSkin, SkinMechanics, TouchingBody
from tacshade_edge.lab.mjcf.taxels import SHELLS
from tacshade_edge.library.result import Result, result_of
from tacshade_edge.rigid import Rigid
from tacshade_edge.sensor.contact.objects import find_objects
from tacshade_edge.sensor.contact.tracking import ContactTracker, follow
from tacshade_edge.sensor.geometry.disc import disc_rays
from tacshade_edge.sensor.touch.touch_answer import touch_without_labels
from tacshade_edge.types import F32, F64, Geometry, HeightMap, ObjectCloud, Pose, Reconstruction

PROFILE: Final = "mujoco"
_MM: Final = 1e3  # in a metre
_CHANNELS = 3  # of a taxel: the depth, and two speeds


class MujocoSensor:
    """A sensor of ``tacshade-edge simulate --mjcf`` in a MuJoCo model; for one thread.

    Attributes
    ----------
    geometry : Geometry
        Skin, camera and visible circle.
    """

    def __init__(self, model: Any, data: Any, name: str = NAME) -> None:
        """Find a sensor in a model.

        Parameters
        ----------
        model, data : mujoco.MjModel, mujoco.MjData
        name : str
            The sensor's name in the model, with the prefix of what it was attached with.

        Raises
        ------
        ConfigError
            The model has no such sensor, or its files were changed or are of another version.
        """
        self.parameters = _parameters(model, name)
        self._mechanics = SkinMechanics(self.parameters.model)
        self._model, self._data = model, data
        sensor, columns = model.sensor(name), len(self._mechanics.taxels.cell)
        self._from, self._shape = int(sensor.adr[0]), (SHELLS, columns)
        if int(sensor.dim[0]) != _CHANNELS * SHELLS * columns:
            raise ConfigError(
                f"{name}: found {int(sensor.dim[0])} numbers of the tactile sensor, expected "
                f"{_CHANNELS * SHELLS * columns}; write its files again with simulate --mjcf"
            )
        self._site, self._flange = model.site(f"{name}_sensor").id, model.body(name).id
        self.geometry: Geometry = self.parameters.model.geometry
        taxels = self._mechanics.taxels
        self._grid, self._rays = taxels.grid, disc_rays(taxels.grid, self.geometry)
        self._zero_mm: F32 = np.where(taxels.inside, np.float32(0), np.float32(np.nan))
        self._tracker, self._seq, self._last_s = ContactTracker(), 0, 0.0

    def read(self, *, shear: bool = True) -> Result:
        """Make the result of the present state, after ``mj_step`` or ``mj_forward``.

        Parameters
        ----------
        shear : bool
            Whether `shear_mm`, twist and slip are computed, which takes twice the time while
            something drags the skin.

        Returns
        -------
        Result
            With the simulation's time as `t_ns`, and the flange's pose in the world as `pose`.
        """
        pose = self.pose()
        return result_of(self.reconstruct(shear=shear), self.geometry, pose, None)

    def reconstruct(self, *, shear: bool) -> Reconstruction:
        """Make what a frame's messages are encoded from."""
        now_s = float(self._data.time)
        if now_s < self._last_s:  # reset
            self._mechanics.forget()
            self._tracker = ContactTracker()
        self._last_s = now_s
        depth_mm = self._depth_mm()
        felt = None
        if depth_mm.any():
            felt = self._mechanics.feel(depth_mm, self._bodies(), with_shear=shear)
        else:
            self._mechanics.forget()
        made = self._made(felt, shear=shear)
        self._seq += 1
        if made.contact:
            touch = touch_without_labels(made.objects, made.shear_of_contact_mm)
            made = replace(made, touch=touch)
        return follow(self._tracker, made)

    def pose(self) -> Pose:
        """The pose of the flange in the world, now."""
        world_T_flange = _pose(self._data.xpos[self._flange], self._data.xmat[self._flange])
        return Pose(self._t_ns, *world_T_flange.seven())

    @property
    def _t_ns(self) -> int:
        return round(float(self._data.time) * 1e9)

    def _depth_mm(self) -> F64:
        shells, columns = self._shape
        depth = self._data.sensordata[self._from : self._from + shells * columns]
        return np.asarray(depth, np.float64).reshape(self._shape) * _MM

    def _made(self, felt: FeltSkin | None, *, shear: bool) -> Reconstruction:
        objects = None
        if felt is not None:
            objects = find_objects(
                felt.contact, felt.height_mm, felt.shear_mm, self._rays, self.geometry
            )
        height_mm, contact, shear_mm = self._zero_mm, np.zeros(self._rays.inside.shape, bool), None
        if shear:
            shear_mm = np.stack((self._zero_mm, self._zero_mm), axis=-1)
        if felt is not None and objects is not None:
            height_mm, contact, shear_mm = felt.height_mm, objects.contact, felt.shear_mm
        nothing = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
        grid = self._grid
        return Reconstruction(
            seq=self._seq,
            t_ns=self._t_ns,
            wall_ns=time.time_ns(),
            profile=PROFILE,
            valid=True,
            reason=None,
            contact=objects is not None,
            saturated=False,
            degraded=None,
            height=HeightMap(height_mm, contact, grid.row0, grid.col0, grid.step_px),
            cloud=nothing if objects is None else objects.cloud,
            objects=() if objects is None else objects.described,
            volume_mm3=0.0 if objects is None else objects.volume_mm3,
            shear_mm=shear_mm,
        )

    def _bodies(self) -> list[TouchingBody]:
        """The bodies that touch the sensor's, each with the mean place of its contacts."""
        model, data = self._model, self._data
        own = model.body_weldid[self._flange]
        sensor_T_world = self._world_T_sensor().inverse()
        places: dict[int, list[F64]] = {}
        for k in range(data.ncon):
            bodies = model.geom_bodyid[data.contact.geom[k]]
            mine = model.body_weldid[bodies] == own
            if mine[0] != mine[1]:
                other = int(bodies[int(mine[0])])
                places.setdefault(other, []).append(data.contact.pos[k] * _MM)
        return [
            TouchingBody(
                number,
                sensor_T_world @ _pose(data.xpos[number], data.xmat[number]),
                sensor_T_world.apply(np.mean(at, axis=0)),
            )
            for number, at in places.items()
        ]

    def _world_T_sensor(self) -> Rigid:
        return _pose(self._data.site_xpos[self._site], self._data.site_xmat[self._site])


def _pose(at_m: F64, matrix: F64) -> Rigid:
    return Rigid(np.array(matrix, float).reshape(3, 3), np.asarray(at_m, float) * _MM)


def _parameters(model: Any, name: str) -> Parameters:
    # Here: whoever has a model has the package, and its files are written without it.
    import mujoco

    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, f"{name}_sensor")
    if number < 0:
        raise ConfigError(
            f"{name}: found no such sensor in the model, expected one that simulate --mjcf wrote"
        )
    begin, size = int(model.text_adr[number]), int(model.text_size[number])
    text = bytes(model.text_data[begin : begin + size]).rstrip(b"\0")
    try:
        return msgspec.json.decode(text, type=Parameters)
    except msgspec.MsgspecError as error:
        raise ConfigError(
            f"{name}_sensor: {error}; write the sensor's files again with simulate --mjcf"
        ) from None
