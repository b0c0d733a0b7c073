"""What all tests share: pytest's own tester, for the plugin's tests."""

pytest_plugins = ["pytester"]
