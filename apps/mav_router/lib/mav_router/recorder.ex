defmodule MavRouter.Recorder do
  @moduledoc """
  Records the frames of links and vehicles in tlog files, which every ground station reads, and keeps the last minutes of each vehicle
  in memory, to be saved when something happens.

      MavRouter.Recorder.start(:default, {:vehicle, "VID-001"}, :armed)
      MavRouter.Recorder.status(:default, {:vehicle, "VID-001"})
      MavRouter.Recorder.save(:default, "VID-001", "near-miss")
      MavRouter.Recorder.list(:default)

  A recording never costs a frame: a process of its own writes it from a bounded queue, and frames that the disk does not take are
  missing in the recording and counted (`dropped`). It has no keys and no signatures (S9). The README of this module's folder tells how
  it works.

  ## Telemetry

  | event | measurements | metadata besides `gateway` |
  |---|---|---|
  | `[:aerie, :recorder, :opened]`, `[:aerie, :recorder, :closed]` | `count`, or `bytes` of the file | `target`, `file` |
  | `[:aerie, :recorder, :paused]` | `count` | `target`, `file`, `reason` (text): the disk is full, … |
  | `[:aerie, :recorder, :removed]` | `bytes` | `file`: an old recording was removed to make room |
  """

  alias Aerie.Base.Error
  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Recorder.{Archive, Recording, Ring, Status, Tables, Tap}
  alias MavCodec.Frame.Splitter
  alias MavCodec.Frame

  @save_ms 10_000

  @typedoc "What is recorded: a link, or a vehicle by its public id or its key."
  @type what :: {:link, String.t()} | {:vehicle, String.t() | {String.t(), non_neg_integer}}

  ## For links and sessions

  @doc "A link received frames."
  @spec link_frames(Names.gateway(), String.t(), [Frame.t()]) :: :ok
  def link_frames(gateway, link, frames) do
    with tables when is_map(tables) <- Tables.of(gateway), do: Tap.offer(tables, {:link, link}, frames)
    :ok
  end

  @doc "What went over a link besides frames; `make` gives it as frames, if the link is recorded."
  @spec link_trace(Names.gateway(), String.t(), (-> [Frame.t()])) :: :ok
  def link_trace(gateway, link, make) do
    with tables when is_map(tables) <- Tables.of(gateway),
         true <- Tap.open?(tables, {:link, link}),
         do: Tap.offer(tables, {:link, link}, make.())

    :ok
  end

  @doc "A vehicle's session got frames."
  @spec vehicle_frames(Names.gateway(), {String.t(), non_neg_integer}, [Frame.t()]) :: :ok
  def vehicle_frames(gateway, key, frames) do
    with tables when is_map(tables) <- Tables.of(gateway), do: keep(tables, key, frames)
    :ok
  end

  defp keep(tables, key, frames) do
    settings = Tables.settings(tables)
    n = if settings.ring, do: Ring.push(tables, settings, key, frames, now())
    Tap.offer(tables, {:vehicle, key}, frames, n)
  end

  @doc "A vehicle is gone: its ring is removed, and its recording ends. What is being saved of it is saved."
  @spec forget(Names.gateway(), {String.t(), non_neg_integer}) :: :ok
  def forget(gateway, key) do
    with tables when is_map(tables) <- Tables.of(gateway), do: Ring.forget(tables, key)
    recording = Names.whereis(gateway, :recording, {:vehicle, key})
    if recording, do: Recording.leave(recording), else: :ok
  end

  @doc "A link sent the bytes of whole frames, which are recorded for it and for the vehicles that are their targets."
  @spec sent(Names.gateway(), String.t(), String.t(), iodata) :: :ok
  def sent(gateway, link, network, bytes) do
    _ =
      with tables when is_map(tables) <- Tables.of(gateway) do
        {frames, _rest} = bytes |> IO.iodata_to_binary() |> Splitter.frames(System.os_time(:microsecond))
        sent_by(tables, link, network, frames)
      end

    :ok
  end

  @doc "The same for forwarded frames."
  @spec sent_frames(Names.gateway(), String.t(), String.t(), [Frame.t()]) :: :ok
  def sent_frames(gateway, link, network, frames) do
    _ = with tables when is_map(tables) <- Tables.of(gateway), do: sent_by(tables, link, network, frames)
    :ok
  end

  # Most frames have no target and go by links that are not recorded: that costs a look at a table.
  defp sent_by(tables, link, network, frames) do
    if Tables.settings(tables).sent do
      if Tap.open?(tables, {:link, link}),
        do: Tap.offer(tables, {:link, link}, Enum.map(frames, &Splitter.checked/1), :sent)

      for frame <- frames,
          {system, _component} when system > 0 <- [Frame.target(frame)],
          key = {network, system},
          Ring.known?(tables, key) or Tap.open?(tables, {:vehicle, key}),
          do: keep(tables, key, [Splitter.checked(frame)])
    end
  end

  ## For interfaces

  @doc """
  Records a link or a vehicle from now on, `:always` or while it is `:armed`, whatever the configuration says, until `stop/2` or the
  end of the gateway.
  """
  @spec start(Names.gateway(), what, :always | :armed) :: :ok | {:error, Error.t()}
  def start(gateway, what, mode \\ :always) when mode in [:always, :armed], do: want(gateway, what, mode)

  @doc "Ends the recording of a link or a vehicle; its file is complete when this returns."
  @spec stop(Names.gateway(), what) :: :ok | {:error, Error.t()}
  def stop(gateway, what), do: want(gateway, what, :off)

  defp want(gateway, what, mode) do
    with {:ok, tables} <- tables(gateway), {:ok, target} <- target(gateway, what) do
      :ets.insert(tables.wanted, {target, mode})

      case Names.whereis(gateway, :recording, target) do
        nil when mode == :off -> :ok
        nil -> begin(gateway, target)
        pid -> Recording.changed(pid)
      end
    end
  catch
    :exit, _reason -> Error.new({:unavailable, "the recording does not answer"})
  end

  @doc false
  # Starts the recording of a target that has none.
  @spec begin(Names.gateway(), Tables.target(), keyword) :: :ok | {:error, Error.t()}
  def begin(gateway, target, options \\ []) do
    options = Keyword.merge([gateway: gateway, target: target, label: label(gateway, target)], options)

    case DynamicSupervisor.start_child(Names.via(gateway, :recordings), {Recording, options}) do
      {:ok, _pid} -> :ok
      {:error, {:already_started, _pid}} -> :ok
      {:error, :max_children} -> Error.new({:limit, "there are as many recordings as the limit allows"})
      other -> Error.new({:unavailable, "the recording cannot be started: #{inspect(other)}"})
    end
  catch
    :exit, _reason -> Error.new({:unavailable, "the recorder is not running"})
  end

  # The beginning of the names of a target's files: its network, and its link or vehicle.
  defp label(gateway, {:link, id}) do
    case Store.link(gateway, id) do
      %{network: network} -> "#{network}-#{id}"
      nil -> id
    end
  end

  defp label(gateway, {_kind, {network, system} = key}) do
    case Store.vehicle(gateway, key) do
      %{id: id} -> "#{network}-#{id}"
      nil -> "#{network}-#{system}"
    end
  end

  @doc """
  Saves a vehicle's ring, and the frames of the next `after_s`, to a file whose name contains the `reason`. Gives the file as soon as the
  ring is in it. If the ring is being saved already, that goes on for longer instead.
  """
  @spec save(Names.gateway(), String.t() | {String.t(), non_neg_integer}, String.t()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def save(gateway, vehicle, reason \\ "request") do
    reference = :erlang.alias([:reply])

    with :ok <- save_at(gateway, vehicle, reason, nil, reference) do
      receive do
        {^reference, {:ok, file}} -> {:ok, file}
        {^reference, {:error, text}} -> Error.new({:unavailable, text})
      after
        @save_ms ->
          :erlang.unalias(reference)
          Error.new({:unavailable, "the disk does not answer"})
      end
    end
  end

  @doc false
  @spec save_at(Names.gateway(), String.t() | tuple, String.t(), integer | nil, reference | nil) ::
          :ok | {:error, Error.t()}
  def save_at(gateway, vehicle, reason, at, notify) do
    with {:ok, tables} <- tables(gateway),
         {:ok, {_kind, key}} <- target(gateway, {:vehicle, vehicle}),
         :ok <- has_ring(tables, key) do
      heard = with %{last_heard: heard} <- Store.vehicle(gateway, key), do: heard
      until = (at || heard || System.os_time(:microsecond)) + Tables.settings(tables).after_ms * 1000
      target = {:saved, key}

      case Names.whereis(gateway, :recording, target) do
        nil ->
          begin(gateway, target, label: label(gateway, target) <> "-" <> reason, until: until, notify: notify)

        pid ->
          longer(pid, until, notify)
      end
    end
  end

  defp has_ring(tables, key) do
    cond do
      Ring.known?(tables, key) -> :ok
      Tables.settings(tables).ring -> Error.new({:unavailable, "nothing was heard from that vehicle"})
      true -> Error.new({:unavailable, "no ring is kept (recorder.ring.enabled)"})
    end
  end

  defp longer(pid, until, notify) do
    Recording.extend(pid, until)
    if notify, do: send(notify, {notify, {:ok, Recording.flush(pid)}})
    :ok
  catch
    :exit, _reason -> Error.new({:unavailable, "the recording does not answer"})
  end

  @doc "The status of the recording of a link or a vehicle; nil when there never was one."
  @spec status(Names.gateway(), what) :: Status.t() | nil
  def status(gateway, what) do
    with {:ok, tables} <- tables(gateway), {:ok, target} <- target(gateway, what) do
      Status.of(tables, target)
    else
      {:error, _reason} -> nil
    end
  end

  @doc "What is shown of the recording of a link or vehicle (`Aerie.Base.Json.Object`)."
  @spec fields :: [Aerie.Base.Json.Object.t()]
  defdelegate fields, to: Status

  @doc "What is shown of a fault of the disk."
  @spec error_fields :: [Aerie.Base.Json.Object.t()]
  defdelegate error_fields, to: Status

  @doc "The part of a recording's status that the snapshot of its link or vehicle shows; nil for none."
  @spec summary(Names.gateway(), Tables.target()) :: map | nil
  def summary(gateway, target) do
    with tables when is_map(tables) <- Tables.of(gateway), do: Status.summary(tables, target)
  end

  @doc """
  The whole status: `recordings` (the statuses of all that are or were made), `rings` (`%{vehicle key => %{bytes, entries}}`), `ring_ms` (how
  far back they go at most), `space`
  (`%{free: bytes or :unknown, low: boolean}`, nil before the first recording), `dir`.
  """
  @spec status(Names.gateway()) :: map | nil
  def status(gateway) do
    with tables when is_map(tables) <- Tables.of(gateway) do
      %{
        dir: Tables.settings(tables).dir,
        recordings: Status.all(tables),
        rings: Ring.sizes(tables),
        ring_ms: Tables.settings(tables).ring_ms,
        space: :ets.lookup_element(tables.notes, :space, 2, nil)
      }
    end
  end

  @doc "Our files, oldest first: `%{file, bytes, at (unix seconds), open}`."
  @spec list(Names.gateway()) :: [map]
  def list(gateway), do: Archive.list(gateway)

  @doc "One of our files by its name; nil for any other name."
  @spec find(Names.gateway(), String.t()) :: map() | nil
  def find(gateway, name), do: Enum.find(list(gateway), &(Path.basename(&1.file) == name))

  @doc "Removes one of our files by its name (`list/1`), unless it is being written."
  @spec delete(Names.gateway(), String.t()) :: :ok | {:error, Error.t()}
  def delete(gateway, name) do
    case Archive.delete(gateway, name) do
      :ok -> :ok
      {:error, :unknown} -> Error.new({:unknown, :recording, name})
      {:error, :open} -> Error.new({:conflict, "#{name} is being written"})
      {:error, text} -> Error.new({:unavailable, text})
    end
  end

  @totals [
    frames: "Frames written to recordings.",
    bytes: "Bytes written to recordings.",
    files: "Recordings begun.",
    dropped: "Frames missing in recordings: disk full or slow.",
    errors: "Faults of the disk; recording goes on after a pause."
  ]

  @doc "Metrics, for `/metrics`: `%{name, type, help, samples: [{labels, value}]}`; without samples while no recorder runs."
  @spec metrics(Names.gateway()) :: [map]
  def metrics(gateway) do
    status = status(gateway)
    recordings = if status, do: status.recordings, else: []
    gauge = fn samples -> if status, do: samples.(), else: [] end

    totals =
      for {key, help} <- @totals do
        samples = for recording <- recordings, do: {[recording: recording.label], recording[key]}
        %{name: "gateway_recorder_#{key}_total", type: :counter, help: help, samples: samples}
      end

    totals ++
      for {name, help, samples} <- [
            {"active", "Recordings that are being written.", fn -> counted(recordings, :recording) end},
            {"paused", "Recordings that cannot be written now: the disk is full or does not work.",
             fn -> counted(recordings, :paused) end},
            {"free_bytes", "Free bytes on the disk of the recordings.", fn -> free(status.space) end},
            {"ring_bytes", "Memory of the rings of all vehicles.",
             fn -> [{[], status.rings |> Map.values() |> Enum.map(& &1.bytes) |> Enum.sum()}] end}
          ] do
        %{name: "gateway_recorder_" <> name, type: :gauge, help: help, samples: gauge.(samples)}
      end
  end

  defp counted(recordings, state), do: [{[], Enum.count(recordings, &(&1.state == state))}]

  defp free(%{free: bytes}) when is_integer(bytes), do: [{[], bytes}]
  defp free(_unknown), do: []

  defp tables(gateway) do
    case Tables.of(gateway) do
      nil -> Error.new({:unavailable, "the recorder is not running"})
      tables -> {:ok, tables}
    end
  end

  defp target(gateway, {:link, id}) when is_binary(id) do
    if Store.link(gateway, id), do: {:ok, {:link, id}}, else: Error.new({:unknown, :link, id})
  end

  defp target(_gateway, {:vehicle, {network, system} = key}) when is_binary(network) and is_integer(system),
    do: {:ok, {:vehicle, key}}

  defp target(gateway, {:vehicle, id}) when is_binary(id) do
    case Store.vehicle(gateway, id) do
      %{key: key} -> {:ok, {:vehicle, key}}
      nil -> Error.new({:unknown, :vehicle, id})
    end
  end

  defp now, do: System.monotonic_time(:millisecond)
end
