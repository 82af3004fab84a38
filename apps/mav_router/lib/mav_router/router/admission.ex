defmodule MavRouter.Router.Admission do
  @again_ms 5_000
  @max_refused 4_096
  # Started at once: one in so many ms, so many in a burst.
  @at_once_ms 250
  @at_once 32
  @busy 64
  @max_waiting 1_024

  @moduledoc """
  Lets a vehicle in when its autopilot is heard: has its processes started, for at most as many vehicles as those allow who have
  them (`MavRouter.Router.Vehicles`). A vehicle that was refused is not tried again for #{div(@again_ms, 1_000)} s, so that a flood
  of invented system ids does not keep their supervisor busy.

  The process that has a vehicle's frames starts it at once as long as few come, #{div(1_000, @at_once_ms)} a second of a link and #{@at_once}
  in a burst, and while no more than #{@busy} messages wait for that process, since other vehicles' frames are among them.
  `MavRouter.Router.Admission.VehicleStarter` starts the others; at most #{@max_waiting} wait, with their first frames (`MavRouter.Router.Admission.EarlyFrames`), which
  their sessions take when they start (`first_frames/2`).
  """

  alias Aerie.Base.Names
  alias MavRouter.Router.AutoSystemId
  alias MavRouter.Forward.Delivery
  alias MavRouter.Router.Admission.EarlyFrames
  alias MavRouter.Tables
  alias MavRouter.Router.Admission.VehicleStarter
  alias Aerie.Base.TokenBucket
  alias MavCodec.Frame

  @doc """
  The session of a vehicle, started if need be. `:coming`: it is being started and gets the `first` frames.
  `:not_yet`: the gateway does not know its own ids, or the vehicle is being started and got frames already.
  """
  @spec session({String.t(), non_neg_integer}, first :: [Frame.t()], Delivery.t()) ::
          {:ok, pid} | :refused | :coming | :not_yet
  def session(key, first, %{gateway: gateway, tables: tables, now: now} = delivery) do
    if AutoSystemId.open?(gateway, tables, key, now) and tables.vehicles != nil,
      do: admit(key, first, delivery),
      else: :not_yet
  end

  defp admit(key, first, %{gateway: gateway, tables: tables, now: now} = delivery) do
    case :ets.lookup(tables.refused, key) do
      [{_key, until}] when now < until ->
        :refused

      _free ->
        if not busy?() and at_once?(tables, delivery),
          do: start(gateway, tables, key, now),
          else: ask(key, first, delivery)
    end
  end

  # Starting one takes as long as reading a hundred datagrams.
  defp busy? do
    {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)
    waiting > @busy
  end

  # While a link's process admits new vehicles, frames of the others wait.
  defp at_once?(tables, %{sender: sender, now: now}) do
    owner = brought_by(sender)

    case TokenBucket.take(Tables.setting(tables, {:admission, owner}, nil), now, @at_once_ms, @at_once) do
      {:ok, full} -> :ets.insert(tables.settings, {{:admission, owner}, full})
      :none -> false
    end
  end

  defp ask(key, first, %{gateway: gateway, tables: tables, sender: sender}) do
    if not :ets.member(tables.waiting, key) and :ets.info(tables.waiting, :size) < @max_waiting do
      # In this order: the process that takes the row finds the frames.
      :ok = EarlyFrames.put(tables, key, first)
      :ets.insert(tables.waiting, {key, sender})
      if not handed_over?(gateway, tables, key), do: VehicleStarter.ask(gateway, key)
      :coming
    else
      :not_yet
    end
  end

  # A session that has just started may have looked for them before they were there.
  defp handed_over?(gateway, tables, key) do
    with session when is_pid(session) <- Names.whereis(gateway, :session, key) do
      with {:frames, _sender, _frames} = first <- take(tables, key), do: send(session, first)
      true
    else
      nil -> false
    end
  end

  @doc """
  Keeps further frames of a vehicle that waits for its session. `{:ok, session}` when it is there after all, `:none` when it does not
  wait, has as many frames as it may have, or got its first ones by another endpoint: whose frame is older nobody could tell then.
  """
  @spec keep(MavRouter.Router.vehicle_key(), [Frame.t()], Delivery.t()) :: :kept | {:ok, pid} | :none
  def keep(key, frames, %{gateway: gateway, tables: tables, sender: sender}) do
    with ^sender <- :ets.lookup_element(tables.waiting, key, 2, :none),
         # It does not overtake frames that were sent directly.
         nil <- Names.whereis(gateway, :session, key),
         :none <- EarlyFrames.keep(tables, key, frames),
         nil <- Names.whereis(gateway, :session, key) do
      :none
    else
      :kept -> :kept
      session when is_pid(session) -> {:ok, session}
      _none_or_another_sender -> :none
    end
  end

  @doc "The link that brought a vehicle, from the sender that its session gets."
  @spec brought_by(sender :: term) :: term
  def brought_by({owner, _peer}), do: owner
  def brought_by(owner), do: owner

  @doc "Starts the vehicle now."
  @spec start(Names.gateway(), Tables.t(), {String.t(), non_neg_integer}, integer) :: {:ok, pid} | :refused
  def start(gateway, tables, key, now) do
    started = tables.vehicles.ensure(gateway, key)
    # Those of a session that was there already.
    first = take(tables, key)

    case started do
      {:ok, session} ->
        {network, system} = key
        if first, do: send(session, first)

        :telemetry.execute([:aerie, :router, :vehicle_found], %{}, %{
          gateway: gateway,
          network: network,
          system: system
        })

        {:ok, session}

      {:error, reason} ->
        dropped(gateway, key, first)
        refuse(gateway, tables, key, reason, now)
    end
  end

  @doc """
  Takes the first frames of a vehicle that was asked for, as a message for its session, nil for none. The session takes them before it
  reads its mailbox: as soon as it has a name, links send it newer ones.
  """
  @spec first_frames(Names.gateway(), {String.t(), non_neg_integer}) :: {:frames, term, [struct]} | nil
  def first_frames(gateway, key) do
    with tables when is_map(tables) <- Tables.of(gateway), do: take(tables, key)
  end

  defp take(tables, key) do
    case :ets.take(tables.waiting, key) do
      [{_key, sender}] -> {:frames, sender, EarlyFrames.take(tables, key)}
      [] -> nil
    end
  end

  defp refuse(gateway, tables, {network, system} = key, reason, now) do
    if :ets.info(tables.refused, :size) < @max_refused,
      do: :ets.insert(tables.refused, {key, now + wait(reason)})

    metadata = %{gateway: gateway, network: network, system: system, reason: reason}
    :telemetry.execute([:aerie, :router, :vehicle_refused], %{}, metadata)
    :refused
  end

  defp dropped(_gateway, _key, nil), do: :ok

  defp dropped(gateway, {network, system}, {:frames, _sender, frames}) do
    metadata = %{gateway: gateway, network: network, system: system, reason: :refused}
    :telemetry.execute([:aerie, :router, :dropped], %{frames: length(frames)}, metadata)
  end

  # Vehicles that are being restarted will be there with the next heartbeat.
  defp wait(:too_many), do: @again_ms
  defp wait(_passing), do: 0
end
