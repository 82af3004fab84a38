defmodule Aerie.Fleet.Bridge.Events.VehicleStreams do
  @moduledoc """
  At a hub (`nats.streams.events_per_vehicle`): a stream of its own for each vehicle's events, `FLEET_EVENTS_{vehicle}`.

  In a common stream a vehicle that sends many events would push out those of the others, and one that uses another one's id
  (`Nats-Msg-Id`) would have the server drop that one's event as a copy.

  This process listens to all events, makes the stream of a vehicle with its first one, and publishes that one once more, which the
  stream confirms to its sender. Every 15 seconds it makes what somebody deleted.

  A stream `FLEET_EVENTS` from before keeps what it has until its age or size ends it, and gets no more.
  """
  use GenServer

  alias Aerie.Fleet.Bridge.{Settings, Streams}
  alias Aerie.Fleet.Bridge.Connection.Subscriber
  alias Aerie.Base.Names
  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.JetStream
  alias Aerie.Base.PubSub
  alias Gnat.Jetstream.API.Stream

  require Logger

  @look_ms 15_000
  @again_ms 2_000
  @max_streams 10_000
  @headers ["Nats-Msg-Id", "Aerie-Backfill"]
  @common "FLEET_EVENTS"

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_event_streams))

  @impl GenServer
  def init(options) do
    gateway = options[:gateway]
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:bridge_event_streams, gateway})
    Logger.metadata(gateway: inspect(gateway))
    :ok = PubSub.subscribe(gateway, :bridge)
    Process.send_after(self(), :look, @look_ms)

    {:ok, %{gateway: gateway, settings: settings, conn: nil, known: MapSet.new(), failed: %{}},
     {:continue, :connect}}
  end

  @impl GenServer
  def handle_continue(:connect, state), do: {:noreply, connect(state)}

  @impl GenServer
  def handle_info({:msg, %{topic: topic} = message}, state) do
    ["fleet", _environment, vehicle | _type] = String.split(topic, ".", parts: 4)

    if MapSet.member?(state.known, vehicle) do
      {:noreply, state}
    else
      state = make(state, vehicle)
      _ = if MapSet.member?(state.known, vehicle), do: again(message)
      {:noreply, state}
    end
  end

  def handle_info({:fleet, :bridge, {:connection, _info}}, state), do: {:noreply, connect(state)}

  def handle_info(:look, state) do
    Process.send_after(self(), :look, @look_ms)
    {:noreply, state |> connect() |> check()}
  end

  def handle_info(_late, state), do: {:noreply, state}

  # The stream's answer is passed on. Without one, its sender sends it again.
  defp again(%{gnat: conn} = message) do
    given = Map.new(Map.get(message, :headers, []))
    headers = for name <- @headers, value = given[String.downcase(name)], do: {name, value}

    with {:ok, %{body: answer}} <-
           Nats.request(conn, message.topic, message.body, headers: headers, receive_timeout: @again_ms),
         reply when reply != nil <- message.reply_to,
         do: Nats.pub(conn, reply, answer)
  end

  defp connect(%{conn: before} = state) do
    state = Subscriber.follow(state, "fleet.#{state.settings.environment}.*.event.>")
    if state.conn not in [nil, before], do: state |> retire() |> check(), else: state
  end

  # Its subjects are those of the streams of the vehicles; the server gives one without a subject its name as one.
  defp retire(%{conn: conn} = state) do
    with {:ok, %{config: there}} <- Nats.call(conn, fn -> Stream.info(conn, @common) end),
         true <- there.subjects != [@common],
         {:ok, _info} <- Nats.call(conn, fn -> Stream.update(conn, %{there | subjects: [@common]}) end) do
      Logger.notice("events are in a stream for each vehicle from now on; #{@common} keeps those from before")
      state
    else
      _none_or_later -> state
    end
  end

  defp check(%{conn: nil} = state), do: state

  defp check(state) do
    case names(state.conn, 0, []) do
      {:ok, there} ->
        Enum.reduce(MapSet.difference(state.known, there), %{state | known: there}, &make(&2, &1))

      {:error, _later} ->
        state
    end
  end

  defp names(conn, offset, found) do
    case JetStream.ask(conn, "$JS.API.STREAM.NAMES", JSON.encode!(%{offset: offset})) do
      {:ok, %{"streams" => [_ | _] = page, "total" => total}} when offset + length(page) < total ->
        names(conn, offset + length(page), page ++ found)

      {:ok, %{"streams" => page}} ->
        {:ok, for(@common <> "_" <> vehicle <- (page || []) ++ found, into: MapSet.new(), do: vehicle)}

      {:ok, _none} ->
        {:ok, MapSet.new()}

      error ->
        error
    end
  end

  defp make(%{conn: nil} = state, _vehicle), do: state

  defp make(state, vehicle) do
    cond do
      now() - Map.get(state.failed, vehicle, now() - @again_ms) < @again_ms ->
        state

      MapSet.size(state.known) >= @max_streams ->
        failed(state, vehicle, "there are #{@max_streams} already")

      true ->
        made(
          state,
          vehicle,
          create(state, Streams.events(state.settings, @common <> "_" <> vehicle, vehicle))
        )
    end
  end

  defp create(%{conn: conn}, wanted), do: Nats.call(conn, fn -> Stream.create(conn, wanted) end)

  # stream name already in use with a different configuration: an operator's
  defp made(state, vehicle, {:error, %{"err_code" => 10_058}}), do: known(state, vehicle)
  defp made(state, vehicle, {:ok, _info}), do: known(state, vehicle)
  defp made(state, vehicle, {:error, reason}), do: failed(state, vehicle, Nats.text(reason))

  defp known(state, vehicle),
    do: %{state | known: MapSet.put(state.known, vehicle), failed: Map.delete(state.failed, vehicle)}

  defp failed(state, vehicle, why) do
    Logger.error(
      "the events of #{vehicle} are not stored: the stream #{@common}_#{vehicle} cannot be made: #{why}"
    )

    failed = if map_size(state.failed) >= @max_streams, do: %{}, else: state.failed
    %{state | failed: Map.put(failed, vehicle, now())}
  end

  defp now, do: System.monotonic_time(:millisecond)
end
