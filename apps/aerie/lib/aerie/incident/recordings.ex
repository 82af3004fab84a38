defmodule Aerie.Incident.Recordings do
  @moduledoc """
  Finds the recordings of a vehicle and of the links that heard it, and copies what they have of a span.

  The vehicle's own recordings, also those that were saved of its last minutes, become `flight.tlog`; frames that two of them have are
  copied once. Each link's become `link-NAME.tlog`. Which vehicle a frame is of is read from the frames, not from the names of files.
  """

  alias Aerie.Fleet.Replay.{Settings, Source}
  alias Aerie.Incident.{Hide, Span}
  alias Aerie.Vehicle.Options
  alias MavCodec.{Frame, Tlog}
  alias MavCodec.Meaning.Heartbeat
  alias MavRouter.Recorder.Archive.Name
  alias MavRouter.Forward.Reach

  @name ~r/\A(.+)-(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d)Z(-\d{1,3})?\.tlog\z/
  # The longest ring (recorder.ring.seconds): what a saved file has from before its name's time.
  @ring_us 3_600_000_000
  # Frames that are written at once.
  @together 1_000
  @heartbeat MavCodec.Messages.Heartbeat.id()

  @typedoc """
  - `vehicle`, `span`; `settings`: how vehicles are named; `networks`: all that there are
  - `sent?`, `between`: `recorder.sent`, `router.between_vehicles`
  - `dir`: of the recordings; `work`: where the copies go; `max_bytes`: of all together
  - `note`: gets a line about each file that is read
  """
  @type want :: %{
          vehicle: String.t(),
          span: Span.t(),
          settings: Settings.t(),
          networks: [String.t()],
          sent?: boolean(),
          between: atom(),
          dir: Path.t(),
          work: Path.t(),
          max_bytes: pos_integer(),
          note: (String.t() -> term())
        }

  @typedoc "`network`: of the vehicle; `frames` copied; `secret`: left out; `damaged`: parts that cannot be read."
  @type copy :: %{
          file: String.t(),
          kind: :vehicle | :link,
          network: String.t(),
          sources: [String.t()],
          frames: non_neg_integer(),
          secret: non_neg_integer(),
          damaged: non_neg_integer(),
          bytes: non_neg_integer()
        }

  @doc "Copies the span. Returns the copies, the vehicle's first, and what could not be read."
  @spec copy(want()) :: {:ok, [copy()], notes :: [String.t()]} | {:error, String.t()}
  def copy(want) do
    case File.ls(want.dir) do
      {:ok, names} ->
        {files, notes} = names |> Enum.flat_map(&candidate(&1, want)) |> begun(want)
        copied(files, want, notes)

      {:error, :enoent} ->
        {:ok, [], ["there are no recordings: #{want.dir} does not exist"]}

      {:error, reason} ->
        {:ok, [], ["recordings: #{want.dir}: #{:file.format_error(reason)}"]}
    end
  end

  defp candidate(name, %{span: span} = want) do
    with [_all, label | digits] <- Regex.run(@name, name),
         {:ok, start} <- start(Enum.take(digits, 6)),
         true <- start - @ring_us <= span.to,
         {:ok, %{type: :regular, mtime: written}} <- File.lstat(Path.join(want.dir, name), time: :posix),
         true <- (written + 1) * 1_000_000 >= span.from do
      network = Name.network(label, want.networks)
      [%{name: name, network: network || hd(want.networks), kind: kind(label, network, want.vehicle)}]
    else
      _other -> []
    end
  end

  defp start(digits) do
    [year, month, day, hour, minute, second] = Enum.map(digits, &String.to_integer/1)

    with {:ok, time} <- NaiveDateTime.new(year, month, day, hour, minute, second),
         do: {:ok, time |> DateTime.from_naive!("Etc/UTC") |> DateTime.to_unix(:microsecond)}
  end

  defp kind(label, network, vehicle) do
    own = Name.label("#{network}-#{vehicle}")
    if label == own or String.starts_with?(label, own <> "-"), do: :vehicle, else: {:link, label}
  end

  # In the order of their first frames, which is not that of their names.
  defp begun(files, want) do
    Enum.reduce(files, {[], []}, fn file, {files, notes} ->
      case first(Path.join(want.dir, file.name)) do
        {:ok, at} -> {[Map.put(file, :first, at) | files], notes}
        :empty -> {files, notes}
        {:error, text} -> {files, [text | notes]}
      end
    end)
    |> then(fn {files, notes} -> {Enum.sort_by(files, &{&1.kind, &1.first, &1.name}), notes} end)
  end

  defp first(path) do
    case path |> Tlog.Reader.frames!() |> Enum.take(1) do
      [frame] -> {:ok, frame.at}
      [] -> :empty
    end
  rescue
    error in File.Error -> {:error, Exception.message(error)}
  end

  defp copied(files, want, notes) do
    {copies, notes} = Enum.reduce(files, {%{}, notes}, &file(&1, &2, want))
    {:ok, copies |> Map.values() |> Enum.sort_by(&{&1.kind != :vehicle, &1.file}), Enum.sort(notes)}
  catch
    {:recordings, text} -> {:error, text}
  end

  defp file(file, {copies, notes}, want) do
    target = target(file.kind)
    before = copies[target] || empty(target, file)
    part = Path.join(want.work, "part")
    want.note.("reading #{file.name}")

    case part(Path.join(want.dir, file.name), part, state(file, before, copies, want)) do
      {:ok, state} ->
        if heard?(state) do
          append(part, Path.join(want.work, target))
          {Map.put(copies, target, merge(before, state, file.name)), notes}
        else
          {copies, notes}
        end

      {:error, text} ->
        {copies, [text | notes]}
    end
  end

  defp target(:vehicle), do: "flight.tlog"
  defp target({:link, label}), do: "link-#{label}.tlog"

  defp empty(target, file) do
    kind = if file.kind == :vehicle, do: :vehicle, else: :link

    %{file: target, kind: kind, network: file.network, sources: [], frames: 0, secret: 0, damaged: 0}
    |> Map.merge(%{bytes: 0, until: nil, last: MapSet.new()})
  end

  defp state(file, before, copies, want) do
    used = copies |> Map.values() |> Enum.map(& &1.bytes) |> Enum.sum()

    %{want: want, network: file.network, heard?: false, systems: %{}, room: want.max_bytes - used, held: []}
    |> Map.merge(%{link?: file.kind != :vehicle, frames: 0, secret: 0, damaged: 0, bytes: 0})
    |> Map.merge(%{over: before.until, overlap: before.last, until: before.until, last: before.last})
  end

  defp part(path, part, state) do
    device = opened(part, [:write, :raw, :binary])
    parser = MavRouter.Link.Settings.parser(state.want.settings.link)

    try do
      with {:ok, state} <- Source.all(path, parser, state, &item(&1, &2, device)),
           do: {:ok, flush(state, device)}
    after
      :file.close(device)
    end
  end

  defp item(%Frame{} = frame, state, device) do
    state = hear(frame, state)

    cond do
      not Span.within?(state.want.span, frame.at) -> state
      copied?(frame, state) -> state
      Hide.frame?(frame) -> %{state | secret: state.secret + 1}
      true -> take(frame, state, device)
    end
  end

  defp item(_damage, state, _device), do: %{state | damaged: state.damaged + 1}

  # A saved ring and a recording of the same time have the same frames.
  defp copied?(_frame, %{over: nil}), do: false

  defp copied?(%{at: at} = frame, %{over: over} = state),
    do: at < over or (at == over and MapSet.member?(state.overlap, frame.bytes))

  # The writer cuts signatures off, and removes the key of SETUP_SIGNING.
  defp take(frame, state, device) do
    record = IO.iodata_to_binary(Tlog.records([frame], signatures: false))
    bytes = state.bytes + byte_size(record)
    if bytes > state.room, do: throw({:recordings, too_large(state.want)})
    state = %{state | frames: state.frames + 1, bytes: bytes, held: [state.held, record]}
    state = if rem(state.frames, @together) == 0, do: flush(state, device), else: state

    cond do
      state.until == nil or frame.at > state.until ->
        %{state | until: frame.at, last: MapSet.new([frame.bytes])}

      frame.at == state.until ->
        %{state | last: MapSet.put(state.last, frame.bytes)}

      true ->
        state
    end
  end

  defp flush(state, device) do
    written(:file.write(device, state.held), state.want.work)
    %{state | held: []}
  end

  defp too_large(want) do
    "the recordings from #{Span.text(want.span.from)} to #{Span.text(want.span.to)} have more than " <>
      "#{div(want.max_bytes, 1_048_576)} MB: take a shorter span, or allow aerie incident more by --max-mb"
  end

  # A recording of a link has what was sent by it as well: what crosses between vehicles (heartbeats), and anything to a
  # line of which nothing is known yet. What is for the vehicle goes where it was heard.
  defp hear(_frame, %{heard?: true} = state), do: state

  defp hear(%Frame{id: @heartbeat, crc_extra: extra, system: system} = frame, state) when extra != nil do
    if not is_map_key(state.systems, system) and Heartbeat.vehicle?(Heartbeat.read(frame)),
      do: %{state | systems: Map.put(state.systems, system, wanted?(system, state))},
      else: state
  end

  defp hear(%Frame{crc_extra: extra, system: system} = frame, %{link?: true} = state) when extra != nil do
    {target, _component} = Frame.target(frame) || {nil, 0}
    said? = state.systems[system] == true and map_size(state.systems) > 1 and not crosses?(frame, state)
    asked? = state.systems[target] == true and not is_map_key(state.systems, system)
    %{state | heard?: said? or asked?}
  end

  defp hear(_frame, state), do: state

  defp wanted?(system, %{want: want, network: network}),
    do: Options.id(want.settings.vehicle, {network, system}) == want.vehicle

  defp crosses?(frame, %{want: want}), do: Reach.passes?(:vehicle, frame, want.between)

  defp heard?(%{heard?: true}), do: true

  defp heard?(%{systems: systems, link?: link?, want: want}) do
    wanted? = Enum.any?(systems, fn {_system, wanted?} -> wanted? end)
    wanted? and (not link? or not want.sent? or map_size(systems) == 1)
  end

  defp append(part, target) do
    device = opened(target, [:append, :raw, :binary])

    result =
      with {:ok, from} <- :file.open(part, [:read, :raw, :binary]) do
        result = :file.copy(from, device)
        _ = :file.close(from)
        result
      end

    _ = :file.close(device)
    written(with({:ok, _bytes} <- result, do: :ok), target)
  end

  defp merge(before, state, name) do
    %{
      before
      | sources: before.sources ++ [name],
        frames: before.frames + state.frames,
        secret: before.secret + state.secret,
        damaged: before.damaged + state.damaged,
        bytes: before.bytes + state.bytes,
        until: state.until,
        last: state.last
    }
  end

  defp opened(path, modes) do
    case :file.open(path, modes) do
      {:ok, device} -> device
      {:error, reason} -> throw({:recordings, "#{path}: #{:file.format_error(reason)}"})
    end
  end

  defp written(:ok, _path), do: :ok
  defp written({:error, reason}, path), do: throw({:recordings, "#{path}: #{:file.format_error(reason)}"})
end
