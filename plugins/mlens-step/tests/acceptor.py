"""What a CAD kernel makes of a STEP file; Open CASCADE stands for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.BRepGProp import BRepGProp
from OCP.gp import gp_Pnt
from OCP.GProp import GProp_GProps
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS_Shape

from magiclens import FloatArray


@dataclass(frozen=True)
class Body:
    """What a file holds, in millimetres."""

    shape: TopoDS_Shape

    @property
    def valid(self) -> bool:
        """Whether curves lie on surfaces, edges on vertices, and wires are closed."""
        return bool(BRepCheck_Analyzer(self.shape).IsValid())

    @property
    def closed_solid(self) -> bool:
        """Whether it is one solid with one shell that encloses it."""
        shells = self._parts(TopAbs_ShapeEnum.TopAbs_SHELL)
        solids = self._parts(TopAbs_ShapeEnum.TopAbs_SOLID)
        return len(solids) == len(shells) == 1 and bool(BRep_Tool.IsClosed_s(shells[0]))

    @property
    def faces(self) -> int:
        """How many there are."""
        return len(self._parts(TopAbs_ShapeEnum.TopAbs_FACE))

    @property
    def volume_mm3(self) -> float:
        """Positive if the shell's normals point out."""
        properties = GProp_GProps()
        BRepGProp.VolumeProperties_s(self.shape, properties, 1e-7)
        return float(properties.Mass())

    @property
    def box_mm(self) -> FloatArray:
        """(2, 3) lowest and highest coordinates."""
        box = Bnd_Box()
        BRepBndLib.AddOptimal_s(self.shape, box, False, False)
        return np.array([[p.X(), p.Y(), p.Z()] for p in (box.CornerMin(), box.CornerMax())])

    def distances_mm(self, points: FloatArray) -> FloatArray:
        """(P,) from each point (P, 3) to the nearest face."""
        shell = self._parts(TopAbs_ShapeEnum.TopAbs_SHELL)[0]
        vertices = [BRepBuilderAPI_MakeVertex(gp_Pnt(*map(float, p))).Vertex() for p in points]
        return np.array([BRepExtrema_DistShapeShape(v, shell).Value() for v in vertices])

    def _parts(self, kind: TopAbs_ShapeEnum) -> list[TopoDS_Shape]:
        explorer, found = TopExp_Explorer(self.shape, kind), []
        while explorer.More():
            found.append(explorer.Current())
            explorer.Next()
        return found


def read(path: Path) -> Body:
    """The shape in a file."""
    reader = STEPControl_Reader()
    assert reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
    assert reader.TransferRoots() == 1
    return Body(reader.OneShape())
