"""Reference tables of the radio from ns-3: ``python scripts/ns3_references.py``. See `studies.ns3`."""

from studies.ns3.runner import ns3_references_app

if __name__ == "__main__":
    ns3_references_app()
