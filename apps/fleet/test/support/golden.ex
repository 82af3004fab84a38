defmodule Aerie.Golden do
  @moduledoc """
  What a recorded flight is expected to give, as a file that a person can read and `git diff` can show. With
  `GOLDEN=write` in the environment the files are written instead of compared.
  """

  import ExUnit.Assertions

  alias Aerie.Base.Json

  @doc "Compares what a replay gave with the file of that name beside the fixtures."
  @spec assert_golden(Aerie.Fleet.Replay.flight(), Path.t()) :: true
  def assert_golden(flight, path) do
    text = text(flight)
    if System.get_env("GOLDEN") == "write", do: File.write!(path, text)
    assert text == File.read!(path)
  end

  @doc "The file's text: seconds since the first frame, the vehicle's own clock (ms), what happened."
  @spec text(Aerie.Fleet.Replay.flight()) :: String.t()
  def text(%{summary: summary} = flight) do
    events = Enum.map(flight.events, &event(&1, summary.from))
    states = Enum.map(flight.snapshots, fn {_id, snapshot} -> state(snapshot) end)

    """
    from #{Json.time(summary.from)} to #{Json.time(summary.to)}: #{summary.frames} frames of #{Enum.join(summary.vehicles, ", ")}

    #{events}
    #{states}
    samples: #{counted(flight.samples, & &1.group)}
    asked: #{counted(flight.sent, &(&1.message.__struct__ |> Module.split() |> List.last()))}
    """
  end

  defp event(event, from) do
    seconds = :io_lib.format("~9.3f", [(event.time - from) / 1_000_000])
    data = event.data |> Map.delete("position") |> Enum.sort() |> Enum.map_join(" ", &pair/1)
    "#{seconds} s #{String.pad_leading("#{event.vehicle_time_ms}", 8)}  #{event.type}  #{data}\n"
  end

  defp state(snapshot) do
    mode = snapshot.groups.mode.data

    "#{snapshot.id}: #{snapshot.status}, #{snapshot.autopilot} #{snapshot.vehicle_type} #{snapshot.firmware}, " <>
      "#{mode.mode}, armed #{mode.armed}, #{mode.landed_state}\n"
  end

  defp pair({key, value}), do: "#{key}=#{inspect(value)}"

  defp counted(list, of) do
    list |> Enum.frequencies_by(of) |> Enum.sort() |> Enum.map_join(", ", fn {what, n} -> "#{what} #{n}" end)
  end
end
