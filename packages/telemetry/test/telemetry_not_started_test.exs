defmodule TelemetryNotStartedTest do
  # Stops the application, so nothing else may run at the same time.
  use ExUnit.Case, async: false

  import ExUnit.CaptureLog

  test "an event before the application runs is lost with a warning, and raises nothing" do
    log =
      capture_log(fn ->
        :ok = Application.stop(:telemetry)
        assert :ok = :telemetry.execute([:a], %{}, %{})
        :ok = Application.start(:telemetry)
      end)

    assert log =~ "is not started"
  end
end
