"""Packages made elsewhere: written by hand, so that what we read is not only what we write."""

import zipfile
from pathlib import Path

import pytest

from cosim.system.fmu_cache import find_fmu

COMMON = "http://ssp-standard.org/SSP1/SystemStructureCommon"
DESCRIPTION = "http://ssp-standard.org/SSP1/SystemStructureDescription"
VALUES = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
MAPPING = "http://ssp-standard.org/SSP1/SystemStructureParameterMapping"

FLAT = f"""<?xml version='1.0'?>
<SystemStructureDescription xmlns="{DESCRIPTION}" xmlns:c="{COMMON}" xmlns:v="{VALUES}" xmlns:m="{MAPPING}"
    version="1.0" name="hand made">
  <System name="top">
    <ParameterBindings><!--top--></ParameterBindings>
    <Elements>
      <Component name="plant" source="resources/models/Pendulum.fmu">
        <Connectors>
          <Connector name="u" kind="input"><c:Real unit="N"/></Connector>
          <Connector name="phi" kind="output"><c:Real/></Connector>
          <Connector name="phi_dot" kind="output"/>
        </Connectors>
        <ParameterBindings><!--plant--></ParameterBindings>
      </Component>
      <Component name="controller" source="./resources/models/PendulumController.fmu" implementation="any">
        <Connectors>
          <Connector name="phi" kind="input"/><Connector name="phi_dot" kind="input"/>
          <Connector name="phi_ref" kind="input"/><Connector name="phi_dot_ref" kind="input"/>
          <Connector name="u" kind="output"><c:Real unit="N"/></Connector>
        </Connectors>
      </Component>
      <Component name="reference" source="resources/models/PendulumReference.fmu">
        <Connectors>
          <Connector name="phi_ref" kind="output"/><Connector name="phi_dot_ref" kind="output"/>
        </Connectors>
      </Component>
    </Elements>
    <Connections>
      <Connection startElement="plant" startConnector="phi" endElement="controller" endConnector="phi"/>
      <Connection startElement="controller" startConnector="phi_dot" endElement="plant" endConnector="phi_dot"/>
      <Connection startElement="reference" startConnector="phi_ref" endElement="controller" endConnector="phi_ref"/>
      <Connection startElement="reference" startConnector="phi_dot_ref" endElement="controller"
        endConnector="phi_dot_ref"/>
      <Connection startElement="controller" startConnector="u" endElement="plant" endConnector="u"/>
    </Connections>
  </System>
  <Units>
    <c:Unit name="N"><c:BaseUnit kg="1" m="1" s="-2"/></c:Unit>
    <c:Unit name="g"><c:BaseUnit kg="1" factor="0.001"/></c:Unit>
    <c:Unit name="deg"><c:BaseUnit rad="1" factor="0.017453292519943295"/></c:Unit>
    <c:Unit name="degC"><c:BaseUnit K="1" offset="273.15"/></c:Unit>
  </Units>
  <DefaultExperiment startTime="0" stopTime="0.2"/>
</SystemStructureDescription>
"""
"""Another layout, no prefix for the structure, one connection written backwards (plant.phi_dot)."""


@pytest.fixture(scope="session")
def flat() -> str:
    """The structure of a package made elsewhere: the pendulum's loop."""
    return FLAT


@pytest.fixture
def package(tmp_path):
    """Writes a package: the structure, the pendulum's FMUs and further files."""

    def write(structure: str = FLAT, files: dict[str, str | bytes] | None = None, name: str = "made.ssp") -> Path:
        path = tmp_path / name
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("SystemStructure.ssd", structure)
            for fmu in ("Pendulum", "PendulumController", "PendulumReference"):
                place = f"resources/models/{fmu}.fmu"
                if place not in (files or {}):
                    archive.write(find_fmu(fmu, Path()), place)
            for place, content in (files or {}).items():
                if content:
                    archive.writestr(place, content)
        return path

    return write
