"""The workbench: one server, one browser and one tab for the tests of this folder alone."""
