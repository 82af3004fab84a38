defmodule Aerie.CLI.ReplayEvents do
  @moduledoc """
  `bin/run --replay FILE --events`: prints the events of a recording as JSON lines, without starting a gateway.

  The lines have the form in which events (and, with `--samples`, state samples) are published to NATS, so that one
  consumer reads both. Keys are sorted: the same recording gives the same bytes in every VM.
  """

  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Base.Json
  alias Aerie.Config
  alias Aerie.Fleet.Replay
  alias Aerie.CLI.{Options, Output, Plan}
  alias MavCodec.Tlog.Damage
  alias MavRouter.Recorder.Archive.Name

  @doc """
  Prints the lines to `:device` (default standard output) and a summary of the recording to `:notes` (default standard
  error).

  `folder` is the user's current directory. An error is a message for the user.
  """
  @spec print(Options.t(), String.t(), keyword) :: :ok | {:error, String.t()}
  def print(%Options{print: what} = options, folder, devices \\ []) do
    device = Keyword.get(devices, :device, :stdio)
    plan = Plan.from(options, folder)

    with {:ok, config} <- load(plan),
         {:ok, note} <- play(Path.expand(options.replay, folder), config, what, device),
         do: IO.write(Keyword.get(devices, :notes, :stderr), note)
  end

  # A reader that closes the pipe (`| head`) ends the program without an error.
  defp play(file, config, what, device) do
    with :ok <- Replay.Source.recording(file),
         {:ok, _acc, summary} <-
           Replay.reduce(file, settings(file, config), :ok, &line(&1, &2, what, device)),
         do: {:ok, note(summary) <> "\n"}
  catch
    :closed -> {:ok, ""}
    {:error, _why} = error -> error
  end

  # The recorder names the network.
  defp settings(file, config) do
    network = file |> Path.basename() |> Name.network(Config.networks(config))
    [settings: Replay.Settings.from(config), network: network]
  end

  defp load(plan) do
    with {:error, errors} <- Config.load(plan.config_file, plan.overrides),
         do: {:error, Config.format_errors(errors)}
  end

  defp line({:event, event}, :ok, what, device),
    do: if(:events in what, do: put(device, Message.event(event)), else: :ok)

  defp line({:sample, s}, :ok, what, device) do
    if :samples in what,
      do: put(device, Message.state(s.vehicle, Atom.to_string(s.group), s.data, s.time_boot_ms, s.at)),
      else: :ok
  end

  defp line(_other, :ok, _what, _device), do: :ok

  defp put(device, json) do
    IO.puts(device, Json.line(json))
  rescue
    _ended in [ArgumentError, ErlangError] ->
      throw(with :ok <- Output.repeat("\n"), do: {:error, "standard output has ended"})
  end

  defp note(%{vehicles: []} = summary), do: "no vehicle in #{summary.frames} frames#{damage(summary)}"

  defp note(summary) do
    seconds = div(summary.duration_us, 1_000_000)
    "#{Enum.join(summary.vehicles, ", ")}: #{summary.frames} frames in #{seconds} s#{damage(summary)}"
  end

  defp damage(%{damage: []}), do: ""

  defp damage(%{damage: [first | _]} = summary) do
    "; #{summary.damaged_bytes} bytes in #{summary.damaged_parts} damaged parts were skipped, the first: #{Damage.format(first)}"
  end
end
