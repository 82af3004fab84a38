defmodule Aerie.CLI.Subcommand.Policy do
  @moduledoc """
  `aerie policy try`: what a policy would have refused of the commands in recorded flights
  (`Aerie.Fleet.Replay.PolicyTrial`), or what it decides about one command. No gateway runs.

  What cannot be read is remarked on, on standard error, and the rest goes on.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Base.Printable
  alias Aerie.CLI.{Output, Subcommand}
  alias Aerie.CLI.PolicyTrial.{Principals, Recordings, Report, SingleCommand}
  alias Aerie.Config
  alias Aerie.Control.Ledger.Envelopes
  alias Aerie.Control.Policy
  alias Aerie.Fleet.Replay
  alias Aerie.Fleet.Replay.{Machine, PolicyTrial, Source}
  alias MavCodec.Frame
  alias MavRouter.Recorder.Archive.Name

  @progress_ms 5_000
  # The clock is not asked with each frame.
  @progress_frames 2_000

  @impl Aerie.CLI.Subcommand
  def run(request) do
    {:ok, _started} = Application.ensure_all_started(:fleet)
    now = System.os_time(:microsecond)

    with {:ok, config} <- config(request),
         {:ok, policy} <- policy(config),
         {:ok, keys} <- Aerie.Access.Keys.load(config.api),
         {:ok, as} <- Principals.as(request.options[:as], policy, keys, now) do
      case request.options do
        %{command: _json} -> SingleCommand.judge(policy, as, request, now)
        %{vehicle: _json} -> {:error, "--vehicle needs --command JSON"}
        _recordings -> recorded(config, policy, keys, as, request)
      end
    end
  catch
    :closed -> {0, ""}
    {:error, _why} = error -> error
  end

  defp recorded(config, policy, keys, as, %{options: options, folder: folder}) do
    with {:ok, ledger} <- ledger(options[:ledger], folder),
         :ok <- network(options[:network], config),
         {:ok, recordings} <-
           Recordings.list(place(options[:recordings], folder, config)) do
      recordings = Enum.map(recordings, &of_network(&1, options[:network], Config.networks(config)))

      trial =
        PolicyTrial.new(policy, Replay.Settings.from(config),
          as: as,
          named: &Principals.named(&1, policy, keys, &2),
          ledger: ledger.entries
        )

      all(recordings, trial, ledger, options[:json] || false)
    end
  end

  defp network(name, config) do
    networks = Config.networks(config)

    if name in [nil | networks],
      do: :ok,
      else: {:error, "--network #{name}: FILE has the networks #{Enum.join(networks, ", ")}"}
  end

  # As the recorder names them; which vehicles a recording has follows from its network.
  defp of_network(%{name: name} = recording, given, networks) do
    network = given || Name.network(name, networks)

    doubts =
      if network == nil and tl(networks) != [],
        do: [
          "#{name}: its name does not begin with a network of FILE (#{Enum.join(networks, ", ")}): its vehicles are " <>
            "judged as those of #{hd(networks)}; --network says another one"
        ],
        else: []

    Map.merge(recording, %{network: network, doubts: doubts})
  end

  # The gateway's own folders are relative to where it runs.
  defp place(nil, _folder, config), do: Path.expand(config.recorder.dir)
  defp place(given, folder, _config), do: Path.expand(given, folder)

  defp config(request) do
    with {:error, errors} <- Subcommand.Machine.Config.load(request),
         do: {:error, Config.format_errors(errors)}
  end

  defp policy(config) do
    with {:error, lines} <- Policy.compile(config.policy), do: {:error, Enum.join(lines, "\n")}
  end

  defp ledger(nil, _folder), do: {:ok, %{entries: [], forgotten: [], damaged: 0}}
  defp ledger(dir, folder), do: dir |> Path.expand(folder) |> Envelopes.read()

  defp all(recordings, trial, ledger, json?) do
    start = %{
      trial: trial,
      total: %Report{},
      judged: 0,
      remarks: about(ledger),
      failed?: ledger.damaged > 0,
      json?: json?
    }

    Enum.each(start.remarks, &note/1)

    result =
      recordings
      |> Enum.with_index(1)
      |> Enum.reduce(start, fn {recording, n}, state ->
        one(state, recording, "#{n} of #{length(recordings)}")
      end)

    late = after_all(result.trial)
    Enum.each(late, &note/1)
    skipped = PolicyTrial.skipped(result.trial)
    remarks = Enum.reverse(result.remarks) ++ late

    put(
      if json?,
        do: Report.json_summary(result.total, result.judged, skipped, remarks),
        else: Report.summary(result.total, result.judged, skipped)
    )

    {status(result), ""}
  end

  defp about(ledger) do
    for {n, text} <- [
          {ledger.damaged, "lines of the ledger are damaged"},
          {length(ledger.forgotten), "commands of the ledger have ended, and their content is not kept"}
        ],
        n > 0,
        do: "#{n} #{text}"
  end

  defp after_all(trial) do
    for(
      name <- PolicyTrial.unnamed(trial),
      do: "the ledger's #{name} has no role in FILE: judged as an operator, or as --as says"
    ) ++
      for {vehicle, n} <- PolicyTrial.missing(trial) do
        "#{n} commands of the ledger are for #{vehicle}, and no recording of that time has a vehicle of this name " <>
          "(the section vehicles of FILE gives names)"
      end
  end

  defp status(%{total: total, judged: judged, failed?: failed?}) do
    cond do
      Report.refused(total) > 0 -> 1
      judged == 0 or failed? -> 2
      true -> 0
    end
  end

  defp one(state, %{path: path, name: name, label: label} = recording, place) do
    before = PolicyTrial.summary(state.trial)
    trial = PolicyTrial.recording(state.trial, label, recording.network)
    options = Machine.parser(trial.settings)
    acc = {trial, %Report{}, %{name: name, place: place, json?: state.json?, frames: 0, due: due()}}

    with :ok <- Recordings.check(recording),
         :ok <- Source.recording(path),
         {:ok, {trial, report, _progress}} <- Source.reduce(path, options, acc, &item/2) do
      summary = PolicyTrial.summary(trial)
      damage = recording.doubts ++ damage(name, before, summary)
      Enum.each(damage, &note/1)
      unless state.json?, do: put([heading(name, summary), Report.table(report), "\n"])

      %{
        state
        | trial: trial,
          total: Report.sum(state.total, report),
          judged: state.judged + 1,
          remarks: damage ++ state.remarks
      }
    else
      {:error, why} ->
        # What was read of it before is not in the numbers.
        note("#{why}; nothing of it counts")
        %{state | remarks: [why | state.remarks], failed?: true}
    end
  end

  defp heading(name, %{vehicles: []}), do: "#{name}: no vehicle was heard\n"
  defp heading(name, summary), do: "#{name}: #{Enum.join(summary.vehicles, ", ")}\n"

  # A recording that goes on with the last one has its damage as well.
  defp damage(name, before, summary) do
    earlier =
      if summary.frames > before.frames and summary.from == before.from, do: before.damaged_parts, else: 0

    parts = summary.damaged_parts - earlier
    if parts > 0, do: ["#{name}: #{parts} damaged parts were skipped"], else: []
  end

  defp item(item, {trial, report, progress}) do
    {trial, decisions} = PolicyTrial.push(trial, item)
    if progress.json?, do: Enum.each(decisions, &put(Report.json(progress.name, &1)))
    {trial, Enum.reduce(decisions, report, &Report.add(&2, &1)), progress(progress, item)}
  end

  defp progress(%{frames: frames} = progress, %Frame{at: at}) when rem(frames, @progress_frames) == 0 do
    if System.monotonic_time(:millisecond) >= progress.due do
      note("#{progress.place}: #{progress.name}, #{frames} frames, at #{Aerie.Base.Json.time(at)}")
      %{progress | frames: frames + 1, due: due()}
    else
      %{progress | frames: frames + 1}
    end
  end

  defp progress(progress, _item), do: %{progress | frames: progress.frames + 1}

  defp due, do: System.monotonic_time(:millisecond) + @progress_ms

  defp note(text), do: IO.puts(:stderr, Printable.lines(text))

  defp put(text) do
    IO.write(text |> IO.iodata_to_binary() |> Printable.lines())
  rescue
    _ended in [ArgumentError, ErlangError] ->
      throw(with :ok <- Output.repeat("\n"), do: {:error, "standard output has ended"})
  end
end
