defmodule MavRouter.Link.Announcer do
  @moduledoc """
  Sends our heartbeat once a second on UDP client links that hear nothing: only so does the other end learn of us. As soon as
  something is heard, the vehicles' sessions keep the connection alive. A peer whose frames are refused because of its
  signing clock has no session; it gets a heartbeat and a TIMESYNC request from here too (`MavRouter.LinkProcess.announce/5`).

  On a link of high latency silence means nothing, and each byte costs (X6): it gets one heartbeat when it opens, and
  others after 30 s, a minute, two … an hour, until something is heard.

  The heartbeat (`MavRouter.Identity.Heartbeat`) has the gateway's own ids and is never that of a ground station (H5).
  """
  use GenServer

  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Identity
  alias MavRouter.Identity.Heartbeat
  alias MavCodec.Frame.Encoder
  alias MavCodec.Messages.Timesync

  @silence_us 3_000_000
  @seldom_us 30_000_000
  @most_seldom_us 3_600_000_000

  @doc "Options: `:gateway`, `:settings` (`MavRouter.Identity.Settings`)."
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options,
      name: Names.via(Keyword.fetch!(options, :gateway), :link_announcer)
    )
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:link_announcer, gateway})
    %Identity.Settings{heartbeat: heartbeat} = settings = Keyword.fetch!(options, :settings)
    _timer = if heartbeat, do: :timer.send_interval(Heartbeat.every_ms(), :announce)
    {:ok, %{gateway: gateway, settings: settings, heartbeat: heartbeat, encoder: nil, seldom: %{}}}
  end

  @impl GenServer
  def handle_cast({:speak, link, peer, scope, system}, state) do
    # A gateway without an id yet sends as a part of that system, which it would be by now if it accepted its frames.
    {encoder, state} =
      case known(state) do
        %{encoder: nil} = state ->
          {Encoder.new(system: system, component: state.settings.component_id), state}

        state ->
          {state.encoder, state}
      end

    {request, encoder} =
      Encoder.encode(encoder, %Timesync{tc1: 0, ts1: System.monotonic_time(:nanosecond)})

    {bytes, encoder} =
      case state.heartbeat && message(state) do
        %_{} = heartbeat ->
          {beat, encoder} = Encoder.encode(encoder, heartbeat)
          {beat <> request, encoder}

        _off_or_held ->
          {request, encoder}
      end

    _ = MavRouter.Link.send_bytes(state.gateway, link, {:sign, scope, bytes}, {:peer, peer})
    {:noreply, if(state.encoder, do: %{state | encoder: encoder}, else: state)}
  end

  @impl GenServer
  def handle_info(:announce, %{encoder: nil} = state) do
    # Nothing is sent before our system id is known (`MavRouter.Router.AutoSystemId`).
    case known(state) do
      %{encoder: nil} = state -> {:noreply, state}
      state -> handle_info(:announce, state)
    end
  end

  def handle_info(:announce, state) do
    now = System.os_time(:microsecond)

    {slow, links} =
      for(link <- Store.links(state.gateway), silent?(link, now), do: link)
      |> Enum.split_with(
        &(&1.high_latency or MavRouter.Router.high_latency?(state.gateway, {&1.id, :remote}))
      )

    {first, seldom} = seldom(state.seldom, slow, System.monotonic_time(:microsecond))

    case links ++ first do
      [] -> {:noreply, %{state | seldom: seldom}}
      links -> {:noreply, announce(%{state | seldom: seldom}, links, message(state))}
    end
  end

  defp known(%{encoder: nil} = state) do
    case Identity.ids(state.settings, state.gateway) do
      {:auto, _component} -> state
      {system, component} -> %{state | encoder: Encoder.new(system: system, component: component)}
    end
  end

  defp known(state), do: state

  defp message(state), do: Heartbeat.message(state.gateway, nil, :onboard_controller)

  defp announce(state, _links, :held), do: state

  defp announce(state, links, heartbeat) do
    {bytes, encoder} = Encoder.encode(state.encoder, heartbeat)

    for link <- links do
      marked = MavRouter.Signing.mark(state.gateway, {link.network, nil}, bytes)

      # A link that was removed meanwhile needs none.
      _ =
        with :ok <- MavRouter.Link.send_bytes(state.gateway, link.id, marked, :all),
             do: Store.count(state.gateway, {:sent, heartbeat.__struct__.id()})
    end

    %{state | encoder: encoder}
  end

  @doc """
  Which of the silent links of high latency are to hear of us now (monotonic us), and when each of those that have not
  been heard since they were opened is to hear of us next.
  """
  @spec seldom(%{term => {due :: integer, wait :: pos_integer}}, [map], integer) :: {[map], map}
  def seldom(before, links, now) do
    unheard = for %{last_heard: heard, since: since} = link <- links, heard == nil or heard < since, do: link

    Enum.reduce(unheard, {[], %{}}, fn %{id: id} = link, {due, seldom} ->
      case Map.get(before, id, {now, @seldom_us}) do
        {at, wait} when at <= now ->
          {[link | due], Map.put(seldom, id, {now + wait, min(2 * wait, @most_seldom_us)})}

        later ->
          {due, Map.put(seldom, id, later)}
      end
    end)
  end

  @doc "Whether a link needs our heartbeat, from its snapshot and the time in unix microseconds."
  @spec silent?(map, integer) :: boolean
  def silent?(%{spec: %{announced: true}, status: status, last_heard: heard}, now)
      when status in [:up, :idle] do
    is_nil(heard) or now - heard > @silence_us
  end

  def silent?(_other, _now), do: false
end
