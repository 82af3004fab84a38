defmodule Aerie.Incident do
  @moduledoc """
  Packs what is known of a vehicle and a span of time into one archive: recordings, events, commands with their
  decisions, audit log, desired state, diagnosis, and a page that plots it. `aerie incident` calls it; the README of
  this module's folder tells what is in it.
  """

  alias Aerie.Base.Names
  alias Aerie.Config
  alias Aerie.Fleet.Replay
  alias Aerie.Incident.{Archive, Commands, Flight, Hide, Page, Recordings, Records, Source, Span, Timeline}
  alias Aerie.Console.Assets
  alias MavRouter.Recorder

  @format 1
  @about %{
    "flight.tlog" => "the vehicle's frames, for any ground station and aerie replay",
    "events.jsonl" => "its events, made from flight.tlog, or else from a link's recording",
    "gateway-events.jsonl" => "the events as the gateway had published them",
    "commands.jsonl" => "commands with their sender, decision, rule and result",
    "audit.jsonl" => "records of the audit log about the vehicle and the gateway",
    "shadow.json" => "desired and reported state when the archive was made",
    "diagnosis.json" => "what was wrong when the archive was made",
    "index.html" => "this page"
  }

  @typedoc """
  - `source`, `vehicle`, `span`, `output` (the path of the archive)
  - `machine`: findings about the machine, for `diagnosis.json`
  - `max_bytes`: of the recordings; `now`: unix microseconds; `note`: gets a line of progress
  """
  @type request :: %{
          source: Source.t(),
          vehicle: String.t(),
          span: Span.t(),
          output: Path.t(),
          machine: [map()],
          max_bytes: pos_integer(),
          now: integer(),
          note: (String.t() -> term())
        }

  @doc "The name of an archive without its extension."
  @spec name(String.t(), Span.t()) :: String.t()
  def name(vehicle, span),
    do:
      "incident-#{vehicle}-#{span.to |> DateTime.from_unix!(:microsecond) |> Calendar.strftime("%Y%m%dT%H%M%SZ")}"

  @doc """
  Makes the archive inside the gateway that it is about, in an empty folder of its own. Returns its path and what could
  not be had.
  """
  @spec make_here(Names.gateway(), String.t(), Span.t(), %{
          folder: Path.t(),
          max_bytes: pos_integer(),
          machine: [map()],
          note: (String.t() -> term())
        }) :: {:ok, Path.t(), notes :: [String.t()]} | {:error, String.t()}
  def make_here(gateway, vehicle, span, %{folder: folder, max_bytes: most, machine: machine, note: note}) do
    output = Path.join(folder, name(vehicle, span) <> ".tar.gz")

    with {:ok, source} <- Source.running(&apply/3, gateway),
         {:ok, _bytes, notes} <-
           make(%{
             source: source,
             vehicle: vehicle,
             span: span,
             output: output,
             machine: machine,
             max_bytes: most,
             now: System.os_time(:microsecond),
             note: note
           }),
         do: {:ok, output, notes}
  end

  @doc "Makes the archive. Returns its size in bytes, and what could not be had."
  @spec make(request()) :: {:ok, non_neg_integer(), notes :: [String.t()]} | {:error, String.t()}
  def make(request) do
    source = Source.with_vehicle(request.source, request.vehicle)
    request = %{request | source: source}

    Archive.with_folder(request.output, fn work ->
      with {:ok, found} <- collect(request, work),
           :ok <- anything(found, request),
           {:ok, files} <- assemble(found, request, work),
           {:ok, size} <-
             Archive.write(request.output, work, name(request.vehicle, request.span), files, request.span.to) do
        {:ok, size, found.notes}
      end
    end)
  end

  # Before all recordings are read.
  defp possible(%{source: %{config: config}, vehicle: vehicle}, commands) do
    if commands != [] or Config.Names.vehicle?(config, vehicle),
      do: :ok,
      else:
        {:error,
         "no vehicle that this gateway hears has the name #{vehicle}: #{Config.Names.vehicles(config)}"}
  end

  defp collect(%{vehicle: vehicle, span: span, source: source} = request, work) do
    config = source.config
    settings = Replay.Settings.from(config)
    {audit, no_audit} = Records.audit(Source.folder(source, config.policy.audit.dir), vehicle, span)
    {ledger, no_ledger} = Records.ledger(Source.folder(source, config.commands.ledger.dir), span)
    commands = Commands.join(audit, ledger, vehicle, span)

    want = %{
      vehicle: vehicle,
      span: span,
      settings: settings,
      networks: Config.networks(config),
      sent?: Recorder.Settings.from(config).sent,
      between: MavRouter.Router.Settings.from(config).between_vehicles,
      dir: Source.folder(source, config.recorder.dir),
      work: work,
      max_bytes: request.max_bytes,
      note: request.note
    }

    with :ok <- possible(request, commands),
         saved = Source.save(source, vehicle, span, request.now),
         {:ok, copies, unread} <- Recordings.copy(want),
         {:ok, flight} <- flight(copies, want, request.note) do
      {events, no_events} = Source.events(source, vehicle)
      {shadow, no_shadow} = Source.shadow(source, vehicle)
      {conditions, no_conditions} = Source.conditions(source, vehicle)

      {:ok,
       %{
         copies: copies,
         flight: flight,
         audit: audit,
         commands: commands,
         events: Enum.filter(events, fn {event, _line} -> Span.within?(span, event.time) end),
         shadow: shadow,
         conditions: conditions,
         secrets: Hide.secrets(config),
         notes:
           saved ++
             recorded(copies, vehicle) ++
             unread ++ no_audit ++ no_ledger ++ no_events ++ no_shadow ++ no_conditions
       }}
    end
  end

  # A wrong name must not look like a quiet flight.
  defp anything(%{commands: [], events: [], copies: copies, notes: notes}, %{vehicle: vehicle, span: span}) do
    if Enum.any?(copies, &(&1.frames > 0)) do
      :ok
    else
      {:error,
       "nothing is known of #{vehicle} from #{Span.text(span.from)} to #{Span.text(span.to)}: no recording, no command, no event " <>
         "(#{Enum.join(notes, "; ")}); is it the name that aerie status shows?"}
    end
  end

  defp anything(_found, _request), do: :ok

  defp recorded(copies, vehicle) do
    damage =
      for %{damaged: n} = copy when n > 0 <- copies,
          do: "#{n} damaged parts of #{Enum.join(copy.sources, ", ")}"

    secret =
      for %{secret: n} = copy when n > 0 <- copies, do: "#{n} frames with passwords or keys (#{copy.file})"

    none =
      if Enum.all?(copies, &(&1.frames == 0)),
        do: ["a recording of #{vehicle}: nothing was recorded then (recorder.vehicles in docs/recordings.md)"],
        else: []

    none ++ damage ++ secret
  end

  # The vehicle's recording, else that of the link that has the most frames.
  defp flight(copies, want, note) do
    case copies
         |> Enum.filter(&(&1.frames > 0))
         |> Enum.sort_by(&{&1.kind != :vehicle, -&1.frames, &1.file}) do
      [] ->
        {:ok, Flight.none(want.vehicle, want.span)}

      [copy | _others] ->
        note.("replaying #{copy.file}: #{copy.frames} frames")
        Flight.read(Path.join(want.work, copy.file), copy.network, want.settings, want.vehicle, want.span)
    end
  end

  # Everything but the recordings, which are in the folder.
  defp assemble(found, request, work) do
    hide = &Hide.plain(&1, found.secrets)
    commands = Enum.map(found.commands, hide)
    audit = Enum.map(found.audit, &%{&1 | fields: hide.(&1.fields)})

    within =
      Enum.filter(Enum.zip(found.audit, audit), fn {record, _hidden} ->
        Span.within?(request.span, record.at)
      end)

    shadow = hide.(found.shadow)
    conditions = hide.(found.conditions)

    files = [
      {"events.jsonl", lines(found.flight.events, found.secrets)},
      {"gateway-events.jsonl", lines(found.events, found.secrets)},
      {"commands.jsonl", Enum.map(commands, &[json(Commands.plain(&1)), ?\n])},
      {"audit.jsonl", for({record, hidden} <- within, do: [line(record, hidden), ?\n])},
      {"shadow.json", [json(%{"at" => Span.text(request.now), "shadow" => shadow}), ?\n]},
      {"diagnosis.json",
       [
         json(%{
           "at" => Span.text(request.now),
           "conditions" => conditions,
           "machine" => hide.(request.machine)
         }),
         ?\n
       ]}
    ]

    {rows, more} =
      Timeline.rows(
        hidden(found.flight.events, hide),
        hidden(found.events, hide),
        commands,
        for({_record, hidden} <- within, do: hidden),
        request.span
      )

    recordings = for %{frames: n} = copy when n > 0 <- found.copies, do: copy

    sizes =
      for(copy <- recordings, do: {copy.file, copy.bytes}) ++
        for({name, text} <- files, do: {name, IO.iodata_length(text)})

    page =
      Page.render(%{
        vehicle: request.vehicle,
        span: request.span,
        version: version(),
        flight: found.flight,
        rows: rows,
        more: more,
        conditions: conditions,
        shadow: shadow,
        notes: Enum.map(found.notes, &Hide.text(&1, found.secrets)),
        files: for({name, bytes} <- sizes, do: {name, bytes, about(name)}),
        plotter: plotter()
      })

    files = files ++ [{"index.html", page}]

    with :ok <- write(work, files),
         names = Enum.map(recordings, & &1.file) ++ Enum.map(files, &elem(&1, 0)),
         manifest = manifest(found, request, recordings, names, work),
         :ok <- write(work, [{"manifest.json", [json(hide.(manifest)), ?\n]}]),
         do: {:ok, ["index.html", "manifest.json" | names -- ["index.html"]]}
  end

  defp plotter do
    with {:ok, script} <- Assets.read("npm/uplot/uPlot.iife.min.js"),
         {:ok, style} <- Assets.read("npm/uplot/uPlot.min.css"),
         do: {script, style},
         else: (_not_installed -> nil)
  end

  defp about(name), do: @about[name] || "what went over a link that heard the vehicle"

  defp lines(events, secrets), do: for({_event, line} <- events, do: [Hide.text(line, secrets), ?\n])
  defp hidden(events, hide), do: for({event, _line} <- events, do: %{event | data: hide.(event.data)})

  # As the log has it, so that its hash can be checked; unless it has a secret.
  defp line(record, hidden),
    do: if(record.fields == hidden.fields, do: record.line, else: json(hidden.fields))

  defp write(work, files) do
    Enum.reduce_while(files, :ok, fn {name, text}, :ok ->
      case File.write(Path.join(work, name), text) do
        :ok -> {:cont, :ok}
        {:error, reason} -> {:halt, {:error, "#{Path.join(work, name)}: #{:file.format_error(reason)}"}}
      end
    end)
  end

  defp manifest(found, request, recordings, names, work) do
    %{
      "format" => @format,
      "vehicle" => request.vehicle,
      "from" => Span.text(request.span.from),
      "to" => Span.text(request.span.to),
      "made_at" => Span.text(request.now),
      "gateway" => if(request.source.call, do: "running", else: "stopped"),
      "versions" => %{"aerie" => version(), "elixir" => System.version(), "otp" => System.otp_release()},
      "only_now" => ["shadow.json", "diagnosis.json"],
      "not_included" => found.notes,
      "counts" => %{
        "events" => length(found.flight.events),
        "events_left_out" => found.flight.left_out,
        "gateway_events" => length(found.events),
        "commands" => length(found.commands)
      },
      "recordings" =>
        for(copy <- recordings, do: copy |> Map.take([:file, :kind, :network, :sources, :frames]) |> plain()),
      "files" => for(name <- names, do: file(Path.join(work, name), name))
    }
  end

  defp plain(map), do: Map.new(map, fn {key, value} -> {to_string(key), value} end)

  defp file(path, name) do
    hash =
      path |> File.stream!(65_536) |> Enum.reduce(:crypto.hash_init(:sha256), &:crypto.hash_update(&2, &1))

    %{
      "name" => name,
      "bytes" => File.stat!(path).size,
      "sha256" => hash |> :crypto.hash_final() |> Base.encode16(case: :lower)
    }
  end

  defp version, do: to_string(Application.spec(:aerie, :vsn))

  # Keys in order: the same content gives the same bytes in every VM.
  defp json(value), do: value |> JSON.encode!() |> Aerie.Base.Json.line()
end
