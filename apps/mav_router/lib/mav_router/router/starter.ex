defmodule MavRouter.Router.Starter do
  @again_ms 5_000
  @max_refused 4_096
  # Started at once: one in so many ms, so many in a burst.
  @at_once_ms 250
  @at_once 32
  @busy 64
  @max_waiting 1_024
  @every_ms 10
  @at_most_ms 250
  @max_reads 128
  @max_kept 16_384
  # Frames of one read: many times those of a datagram or of a radio's read.
  @max_frames 16

  @moduledoc """
  Lets a vehicle in when its autopilot is heard: has its processes started, for at most as many vehicles as
  `MavRouter.Router.Vehicles` allows. A vehicle that was refused is not tried again for #{div(@again_ms, 1_000)} s, so
  that a flood of invented system ids does not keep their supervisor busy.

  The process that has a vehicle's frames starts it at once as long as few come, #{div(1_000, @at_once_ms)} a second of
  a link and #{@at_once} in a burst, and while no more than #{@busy} messages wait for that process, since other
  vehicles' frames are among them. The others wait in the table `waiting`, #{@max_waiting} at most, and this process
  starts them one after the other: #{div(1_000, @every_ms)} a second, #{div(1_000, @at_most_ms)} on a machine that is
  too busy (`pause/1`), the links by turns. It keeps nothing that its successor would not find in the tables.

  The frames of a vehicle that waits are kept in the table `early`, in the order in which they came, for its session to
  take when it starts (`first_frames/2`): those of the read in which it was found and of #{@max_reads} more reads,
  #{@max_frames} of each, and no more than those of #{@max_kept} reads of all vehicles (64 MiB if all are as long as can
  be). A row in `waiting` is the gate: the process that takes the row collects the frames. A process that keeps more
  writes first and looks for the row afterwards. If it is there, it will be taken later, and what was written will be
  found. If it is gone, the writer takes back what it wrote, unless it was collected in between. So each frame arrives
  once, whichever process is faster.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Base.Timing.TokenBucket
  alias MavCodec.Frame
  alias MavRouter.Forward.Delivery
  alias MavRouter.Router.AutoSystemId
  alias MavRouter.Tables

  @type key :: MavRouter.Router.vehicle_key()

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :vehicle_starter))
  end

  ## In the process that has the frames

  @doc """
  The session of a vehicle, started if need be. `:coming`: it is being started and gets the `first` frames.
  `:not_yet`: the gateway does not know its own ids, or the vehicle is being started and got frames already.
  """
  @spec session(key, first :: [Frame.t()], Delivery.t()) :: {:ok, pid} | :refused | :coming | :not_yet
  def session(key, first, %{gateway: gateway, tables: tables, now: now} = delivery) do
    cond do
      not AutoSystemId.open?(gateway, tables, key, now) or tables.vehicles == nil -> :not_yet
      now < :ets.lookup_element(tables.refused, key, 2, now) -> :refused
      not busy?() and at_once?(delivery) -> start(gateway, tables, key)
      true -> wait(key, first, delivery)
    end
  end

  # Starting one takes as long as reading a hundred datagrams.
  defp busy? do
    {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)
    waiting > @busy
  end

  # While a link's process starts vehicles, frames of the others wait.
  defp at_once?(%{tables: tables, sender: sender, now: now}) do
    bucket = {:starts, brought_by(sender)}

    case TokenBucket.take(Tables.setting(tables, bucket, nil), now, @at_once_ms, @at_once) do
      {:ok, full} -> :ets.insert(tables.settings, {bucket, full})
      :none -> false
    end
  end

  defp wait(key, first, %{gateway: gateway, tables: tables, sender: sender}) do
    if :ets.member(tables.waiting, key) or :ets.info(tables.waiting, :size) >= @max_waiting do
      :not_yet
    else
      # In this order: the process that takes the row finds the frames.
      {_key, number} = write(tables, key, first)
      :ets.insert(tables.waiting, {key, sender, number})

      case Names.whereis(gateway, :session, key) do
        nil -> with pid when is_pid(pid) <- Names.whereis(gateway, :vehicle_starter), do: send(pid, :more)
        # It has just started, and may have looked for them before they were there.
        session -> hand_over(take(tables, key), session)
      end

      :coming
    end
  end

  defp hand_over(nil, _session), do: :ok
  defp hand_over(first, session), do: send(session, first)

  @doc """
  Keeps further frames of a vehicle that waits for its session, and says whether it did: not when there is a session
  after all, which may have got newer frames directly, when the vehicle has as many as it may have, or got its first
  ones by another endpoint: whose frame is older nobody could tell then.
  """
  @spec keep?(key, [Frame.t()], Delivery.t()) :: boolean
  def keep?(key, frames, %{gateway: gateway, tables: tables, sender: sender}) do
    :ets.lookup_element(tables.waiting, key, 2, :none) == sender and
      Names.whereis(gateway, :session, key) == nil and room?(tables, key, frames) and
      kept?(tables, key, frames)
  end

  # The key of the frames by number, and the numbers of all that the vehicle has, are one range of the table.
  defp room?(tables, key, frames) do
    length(frames) <= @max_frames and :ets.info(tables.early, :size) < @max_kept and
      :ets.select_count(tables.early, [{{{key, :_}, :_}, [], [true]}]) < @max_reads
  end

  defp kept?(tables, key, frames) do
    row = write(tables, key, Enum.map(frames, &own/1))
    :ets.member(tables.waiting, key) or :ets.take(tables.early, row) == []
  end

  # A frame refers to all that was read with it, up to 64 KiB.
  defp own(frame),
    do: %{frame | bytes: :binary.copy(frame.bytes), payload: :binary.copy(frame.payload)}

  defp write(tables, key, frames) do
    row = {key, number()}
    true = :ets.insert(tables.early, {row, frames})
    row
  end

  ## In the session

  @doc """
  Takes the first frames of a vehicle that waited, as a message for its session, nil for none. The session takes them
  before it reads its mailbox: as soon as it has a name, links send it newer ones.
  """
  @spec first_frames(Names.gateway(), key) :: {:frames, term, [Frame.t()]} | nil
  def first_frames(gateway, key) do
    with tables when is_map(tables) <- Tables.of(gateway), do: take(tables, key)
  end

  defp take(tables, key) do
    with [{_key, sender, _number}] <- :ets.take(tables.waiting, key) do
      frames =
        for number <- :ets.select(tables.early, [{{{key, :"$1"}, :_}, [], [:"$1"]}]),
            {_row, frames} <- :ets.take(tables.early, {key, number}),
            frame <- frames,
            do: frame

      {:frames, sender, frames}
    else
      [] -> nil
    end
  end

  ## In the starter

  @doc "The pause after a start that took so many ms: #{@every_ms} to #{@at_most_ms} ms."
  @spec pause(non_neg_integer) :: pos_integer
  def pause(took) when is_integer(took), do: (4 * took) |> max(@every_ms) |> min(@at_most_ms)

  # The frames of those that are there come first.
  @impl GenServer
  def init(gateway) do
    Process.flag(:priority, :low)
    Process.set_label({:vehicle_starter, gateway})
    {:ok, %{gateway: gateway, turns: %{}, timer: Process.send_after(self(), :next, 0)}}
  end

  @impl GenServer
  def handle_info(:more, %{timer: nil} = state), do: {:noreply, next(state)}
  def handle_info(:more, state), do: {:noreply, state}
  def handle_info(:next, state), do: {:noreply, next(state)}

  defp next(%{gateway: gateway, turns: turns} = state) do
    tables = Tables.of(gateway)

    case tables && next_waiting(tables, turns) do
      nil ->
        %{state | timer: nil, turns: %{}}

      {key, sender, _number} ->
        began = now()
        _ = start(gateway, tables, key)
        timer = Process.send_after(self(), :next, pause(now() - began))
        %{state | timer: timer, turns: Map.put(turns, brought_by(sender), number())}
    end
  end

  @doc """
  The waiting vehicle that is started next: the first one of the link whose turn (`turns`) was longest ago, so that
  hundreds from one link keep none of another waiting.
  """
  @spec next_waiting(Tables.t(), %{term => pos_integer}) :: {key, sender :: term, number :: pos_integer} | nil
  def next_waiting(tables, turns) do
    tables.waiting
    |> :ets.tab2list()
    |> Enum.min_by(fn {_key, sender, number} -> {turns[brought_by(sender)] || 0, number} end, fn -> nil end)
  end

  defp brought_by({owner, _peer}), do: owner
  defp brought_by(owner), do: owner

  ## In whichever starts the vehicle

  defp start(gateway, tables, {network, system} = key) do
    started = tables.vehicles.ensure(gateway, key)
    # Those of a session that was there already.
    first = take(tables, key)
    metadata = %{gateway: gateway, network: network, system: system}

    case started do
      {:ok, session} ->
        hand_over(first, session)
        :telemetry.execute([:aerie, :router, :vehicle_found], %{}, metadata)
        {:ok, session}

      {:error, reason} ->
        dropped(first, metadata)
        refuse(tables, key, reason)
        :telemetry.execute([:aerie, :router, :vehicle_refused], %{}, Map.put(metadata, :reason, reason))
        :refused
    end
  end

  defp dropped(nil, _metadata), do: :ok

  defp dropped({:frames, _sender, frames}, metadata) do
    metadata = Map.put(metadata, :reason, :refused)
    :telemetry.execute([:aerie, :router, :dropped], %{frames: length(frames)}, metadata)
  end

  # Vehicles that are being restarted (`:not_running`) will be there with the next heartbeat.
  defp refuse(tables, key, :too_many) do
    if :ets.info(tables.refused, :size) < @max_refused,
      do: :ets.insert(tables.refused, {key, now() + @again_ms})
  end

  defp refuse(_tables, _key, _passing), do: false

  defp number, do: System.unique_integer([:monotonic, :positive])
  defp now, do: System.monotonic_time(:millisecond)
end
