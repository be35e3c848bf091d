"""The paper's figures and table, from runs of ours."""
