"""The paper's figures and table, reproduced with our own runs."""
