"""The paper's possible ways to improve, each as a study: docs/improve.md."""
