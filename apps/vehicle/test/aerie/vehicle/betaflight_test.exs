defmodule Aerie.Vehicle.BetaflightTest do
  @moduledoc """
  Betaflight's MAVLink telemetry: MAVLink 1, an autopilot of no kind, and a GLOBAL_POSITION_INT whose `time_boot_ms` is
  `micros()`, beside an ATTITUDE with `millis()`.
  """
  use ExUnit.Case, async: true

  import Aerie.Flight

  alias Aerie.Vehicle.Session.Core
  alias MavCodec.Messages, as: M

  @second 1_000_000

  # From `boot_s` seconds after its boot on, `seconds` long, received from `at` (s) on.
  defp flight(boot_s, seconds, at) do
    for n <- 0..(seconds * 10), message <- messages(n, round((boot_s + n / 10) * @second)) do
      frame(message, round((at + n / 10) * @second), version: 1)
    end
  end

  defp messages(n, us) do
    position = %M.GlobalPositionInt{lat: 473_977_420, lon: 85_455_940, alt: 500_000, relative_alt: 20_000}

    [
      %M.Attitude{time_boot_ms: div(us, 1000), roll: 0.1},
      if(rem(n, 2) == 0, do: %{position | time_boot_ms: Integer.mod(us, 0x100000000)}),
      if(rem(n, 10) == 0, do: %M.Heartbeat{type: 2, autopilot: 0, base_mode: 0x81, system_status: 4})
    ]
    |> Enum.reject(&is_nil/1)
  end

  defp types(run), do: for({type, _ms, _data} <- pick(run, ~w(reboot collision)), do: type)

  test "is neither a reboot nor a second vehicle, even when its microseconds wrap" do
    run = run(flight(4_250, 120, 1_000))
    assert types(run) == []
    snapshot = Core.snapshot(run.core)
    assert {snapshot.time_boot_ms, snapshot.collision} == {4_370_000, nil}
    assert %{data: %{lat: 47.397742}, time_boot_ms: 4_370_000, at: 1_120_000_000} = snapshot.groups.position
  end

  test "R6: a restart is a reboot" do
    assert [{"reboot", ms, _data}] =
             flight(300, 30, 1_000)
             |> Kernel.++(flight(3, 30, 1_035))
             |> run()
             |> pick(~w(reboot collision))

    assert ms in 1_035_000..1_038_000
  end

  test "two of them with one id are a collision" do
    frames = Enum.sort_by(flight(300, 20, 1_000) ++ flight(30, 20, 1_000.05), & &1.at)
    assert "collision" in types(run(frames))
  end
end
