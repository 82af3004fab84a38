defmodule Phoenix.LiveView.Cowboy.Socket do
  @moduledoc """
  The process of one WebSocket: reads frames, starts a channel for each view that joins, and writes the channels' messages.

  A request is refused before it becomes a WebSocket if its `Origin` is not allowed, its CSRF token is not the session's, or it
  uses another version of the protocol. The end of its session closes it (`:over?` of the server). An invalid frame, or more events a second than a person can cause,
  closes the connection, never with code 1000, which makes the client reload the page.
  """
  @behaviour :cowboy_websocket

  alias Phoenix.LiveView.{Channel, Cookie}
  alias Phoenix.LiveView.Cowboy.{Frame, Page}
  alias Phoenix.LiveView.View.Join

  @going_away 1001
  @unsupported 1003
  @refused 1008

  # How long a view that is being left may take to finish.
  @leave_ms 5_000

  @impl :cowboy_websocket
  def init(request, server) do
    session = Cookie.read(request, server.secret, server.cookie)
    query = request |> :cowboy_req.parse_qs() |> Map.new()

    cond do
      not server.origin?.(request) ->
        refuse(request, server, "this page's origin may not use the server")

      not match?("2." <> _, query["vsn"]) ->
        refuse(request, server, "vsn: expected 2.0.0")

      not Cookie.csrf?(session, query["_csrf_token"]) ->
        refuse(request, server, "the page's token is not the session's")

      true ->
        upgrade(request, server, session)
    end
  end

  defp refuse(request, server, words) do
    {:ok, :cowboy_req.reply(403, %{"content-type" => "text/plain"}, words <> "\n", request), server}
  end

  defp upgrade(request, server, session) do
    info = %{
      session: Map.merge(session, server.session.(request)),
      peer_data: Page.peer(request)
    }

    options = %{
      compress: true,
      # A third of the work of the usual 6, for a fifth more bytes (rows of a map of 200 vehicles).
      deflate_opts: %{level: 3},
      max_frame_size: server.max_frame,
      idle_timeout: server.idle_ms + 30_000
    }

    {:cowboy_websocket, request, %{server: server, info: info, channels: %{}, budget: {0, 0}, heard: now()},
     options}
  end

  @impl :cowboy_websocket
  def websocket_init(state) do
    Process.set_label(:live_view_socket)
    Process.send_after(self(), :watch, state.server.idle_ms)
    _ = state.server.opened.(state.info.session)
    {[], state}
  end

  @impl :cowboy_websocket
  def websocket_handle({:text, text}, state) do
    with {:ok, state} <- admit(state), {:ok, frame} <- Frame.decode(text) do
      frame(frame, %{state | heard: now()})
    else
      {:flood, state} -> close(@refused, "more events than a person can cause", state)
      :error -> close(@unsupported, "expected [join_ref, ref, topic, event, payload]", state)
    end
  end

  def websocket_handle({:binary, _data}, state), do: close(@unsupported, "there are no uploads", state)
  def websocket_handle(_ping, state), do: {[], state}

  defp close(code, words, state) do
    {[{:close, code, words}], state}
  end

  # Limits the messages in each second.
  defp admit(%{server: server, budget: {second, count}} = state) do
    case div(now(), 1_000) do
      ^second when count >= server.max_events -> {:flood, state}
      ^second -> {:ok, %{state | budget: {second, count + 1}}}
      another -> {:ok, %{state | budget: {another, 1}}}
    end
  end

  defp frame({_join_ref, ref, "phoenix", "heartbeat", _payload}, state), do: ok(nil, ref, "phoenix", state)

  defp frame({join_ref, ref, topic, "phx_join", payload}, state) do
    state = leave(state, topic)

    if map_size(state.channels) >= state.server.max_channels,
      do: error(join_ref, ref, topic, "too many channels joined", state),
      else: join(join_ref, topic, payload, state)
  end

  defp frame({join_ref, ref, topic, "phx_leave", _payload}, state),
    do: ok(join_ref, ref, topic, leave(state, topic))

  defp frame({join_ref, ref, topic, event, payload}, state) do
    case state.channels do
      %{^topic => %{join_ref: ^join_ref, pid: pid}} ->
        Channel.event(pid, ref, event, payload)
        {[], state}

      # A message from before the last join, which the client has also forgotten.
      %{^topic => _channel} ->
        {[], state}

      _unknown ->
        error(join_ref, ref, topic, "unmatched topic", state)
    end
  end

  defp join(join_ref, topic, payload, %{server: server, info: info} = state) do
    join = fn transport -> Join.join(server, topic, payload, info, transport) end

    options = [
      transport: self(),
      topic: topic,
      join_ref: join_ref,
      join: join,
      encode: &Frame.encode/5,
      priority: server.priority
    ]

    case DynamicSupervisor.start_child(server.supervisor, {Channel, options}) do
      {:ok, pid} ->
        channel = %{pid: pid, monitor: Process.monitor(pid), join_ref: join_ref, joined?: false}
        {[], put_in(state.channels[topic], channel)}

      {:error, :max_children} ->
        error(join_ref, join_ref, topic, "too many views on this server", state)
    end
  end

  # The old view of a topic ends before the new one starts.
  defp leave(state, topic) do
    case Map.pop(state.channels, topic) do
      {nil, _channels} ->
        state

      {%{pid: pid, monitor: monitor}, channels} ->
        Channel.leave(pid)

        receive do
          {:DOWN, ^monitor, :process, ^pid, _reason} -> :ok
        after
          @leave_ms ->
            Process.demonitor(monitor, [:flush])
            Process.exit(pid, :kill)
        end

        %{state | channels: channels}
    end
  end

  @impl :cowboy_websocket
  def websocket_info({Channel, pid, frame}, state) do
    case Enum.find(state.channels, fn {_topic, channel} -> channel.pid == pid end) do
      {topic, channel} ->
        Channel.written(pid)
        {[{:text, frame}], put_in(state.channels[topic], %{channel | joined?: true})}

      # Messages of a view that has been left are dropped.
      nil ->
        {[], state}
    end
  end

  def websocket_info({:DOWN, monitor, :process, _pid, reason}, state) do
    case Enum.find(state.channels, fn {_topic, channel} -> channel.monitor == monitor end) do
      {topic, channel} ->
        {over(topic, channel, reason), %{state | channels: Map.delete(state.channels, topic)}}

      nil ->
        {[], state}
    end
  end

  def websocket_info(:watch, %{server: server, heard: heard} = state) do
    if now() - heard > server.idle_ms do
      {[{:close, @going_away, "nothing was heard"}], state}
    else
      Process.send_after(self(), :watch, server.idle_ms)
      {[], state}
    end
  end

  def websocket_info({__MODULE__, :over}, state), do: {[{:close, @refused, "the session is over"}], state}

  # Views that end with the session say so to the browser first.
  def websocket_info(message, %{server: server, info: %{session: session}} = state) do
    with {:close, ms} <- server.over?.(message, session),
         do: Process.send_after(self(), {__MODULE__, :over}, ms)

    {[], state}
  end

  # A refused view has been answered; one that left is closed; after a crash the client joins again.
  defp over(_topic, _channel, {:shutdown, :refused}), do: []
  # Its queue became too long; the client joins again and gets the newest state.
  defp over(topic, %{join_ref: ref}, {:shutdown, :slow}),
    do: [text(ref, ref, topic, "phx_error", %{reason: "the browser reads too slowly"})]

  defp over(topic, %{join_ref: ref}, {:shutdown, _left}), do: [text(ref, ref, topic, "phx_close", %{})]

  defp over(topic, %{join_ref: ref, joined?: false}, _crashed),
    do: [text(ref, ref, topic, "phx_reply", %{status: "error", response: %{reason: "join crashed"}})]

  defp over(topic, %{join_ref: ref}, _crashed),
    do: [text(ref, ref, topic, "phx_error", %{reason: "the view crashed"})]

  defp ok(join_ref, ref, topic, state),
    do: {[text(join_ref, ref, topic, "phx_reply", %{status: "ok", response: %{}})], state}

  defp error(join_ref, ref, topic, reason, state),
    do: {[text(join_ref, ref, topic, "phx_reply", %{status: "error", response: %{reason: reason}})], state}

  defp text(join_ref, ref, topic, event, payload),
    do: {:text, Frame.encode(join_ref, ref, topic, event, payload)}

  defp now, do: System.monotonic_time(:millisecond)
end
