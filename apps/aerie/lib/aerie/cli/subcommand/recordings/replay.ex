defmodule Aerie.CLI.Subcommand.Recordings.Replay do
  @moduledoc """
  `aerie replay`: prints the events of a recording as JSON lines, and a summary of it on standard error. No gateway
  runs.

  The lines have the form in which events (and, with `--samples`, state samples) are published to NATS, so that one
  consumer reads both. Keys are sorted: the same recording gives the same bytes in every VM.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Base.Json
  alias Aerie.CLI.{Output, Subcommand}
  alias Aerie.Config
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Fleet.Replay
  alias MavCodec.Tlog.Damage
  alias MavRouter.Recorder.Archive.Name

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"FILE" => file}, options: options, folder: folder} = request) do
    {:ok, _started} = Application.ensure_all_started(:fleet)

    # FILE is the recording here, not the configuration.
    case Subcommand.Machine.Config.load(%{request | arguments: %{}}) do
      {:ok, config} -> play(Path.expand(file, folder), config, options[:samples] || false)
      {:error, errors} -> {:error, Config.format_errors(errors)}
    end
  end

  # A reader that closes the pipe (`| head`) ends the program without an error.
  defp play(file, config, samples?) do
    with :ok <- Replay.Source.recording(file),
         {:ok, _acc, summary} <- Replay.reduce(file, settings(file, config), :ok, &line(&1, &2, samples?)) do
      IO.puts(:stderr, note(summary))
      {0, ""}
    end
  catch
    :closed -> {0, ""}
    {:error, _why} = error -> error
  end

  # The recorder names the network.
  defp settings(file, config) do
    network = file |> Path.basename() |> Name.network(Config.networks(config))
    [settings: Replay.Settings.from(config), network: network]
  end

  defp line({:event, event}, :ok, _samples?), do: put(Message.event(event))

  defp line({:sample, s}, :ok, true),
    do: put(Message.state(s.vehicle, Atom.to_string(s.group), s.data, s.time_boot_ms, s.at))

  defp line(_other, :ok, _samples?), do: :ok

  defp put(json) do
    IO.puts(Json.line(json))
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
    "; #{summary.damaged_bytes} bytes in #{summary.damaged_parts} damaged parts were skipped, the first: " <>
      Damage.format(first)
  end
end
