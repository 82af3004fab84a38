defmodule MavRouter.Link.Transport.TcpAcceptor do
  # One address is often a whole site behind a router, or several programs of this machine.
  @per_address 64
  @connections 256
  # As for senders of datagrams: a program that connects says something sooner.
  @yields_ms 5_000

  @moduledoc """
  Accepts the connections of a TCP server, in a process of its own that is linked to the link's: accepting blocks, and
  a connection beyond the limits is closed here, not in the path of frames. There may be #{@connections} connections
  to a port, #{@per_address} of them from one address.

  At a limit, a newcomer takes the place of the earliest connection that has been there for #{div(@yields_ms, 1_000)}
  s and never sent a byte: one of its own address, or, if the port is full, one of the address with the most
  connections. So connections that do nothing keep nobody out.

  The link gets `{:accepted, listener, socket, address}` for each connection and answers `heard/2` with its first
  bytes and `gone/2` when it has ended; `{:yield, listener, socket}` asks it to end one. It gets `{:refused, listener,
  n, text}` at most once a second.
  """

  alias MavRouter.Link.Transport.Net

  @every_ms 1_000

  @typedoc """
  The connections by socket: their address, and since when each has been silent (monotonic ms), nil once it
  has sent something.
  """
  @type held :: %{:gen_tcp.socket() => {:inet.ip_address(), since :: integer | nil}}

  @doc "Starts to accept for the calling process; the options are for the sockets of those that have room."
  @spec start(:gen_tcp.socket(), keyword) :: pid
  def start(listener, options) do
    link = self()

    spawn_link(fn ->
      Process.set_label({:acceptor, Net.local(listener).local})
      accept(%{listener: listener, options: options, link: link, held: %{}, refused: 0, text: nil, told: nil})
    end)
  end

  @doc "A connection has sent its first bytes."
  @spec heard(pid, :gen_tcp.socket()) :: :ok
  def heard(acceptor, socket) do
    _ = send(acceptor, {:heard, socket})
    :ok
  end

  @doc "A connection has ended."
  @spec gone(pid, :gen_tcp.socket()) :: :ok
  def gone(acceptor, socket) do
    _ = send(acceptor, {:gone, socket})
    :ok
  end

  @doc "Whether one more connection from an address has room, at the cost of which one, or why not. Pure."
  @spec check(held, :inet.ip_address(), now :: integer) ::
          :ok | {:yields, :gen_tcp.socket()} | {:refused, String.t()}
  def check(held, address, now) do
    by_address = held |> Map.values() |> Enum.frequencies_by(&elem(&1, 0))

    cond do
      Map.get(by_address, address, 0) >= @per_address ->
        with nil <- yields(held, [address], now),
             do:
               {:refused,
                "connections of #{:inet.ntoa(address)} are refused: it has #{@per_address}, " <>
                  "which is the most for one address"}

      map_size(held) >= @connections ->
        {_address, most} = Enum.max_by(by_address, &elem(&1, 1))

        with nil <- yields(held, for({address, ^most} <- by_address, do: address), now),
             do:
               {:refused,
                "connections are refused: there are #{@connections}, which is the most for one port"}

      true ->
        :ok
    end
  end

  defp yields(held, addresses, now) do
    silent =
      for {socket, {address, since}} <- held,
          since != nil and now - since >= @yields_ms and address in addresses,
          do: {since, socket}

    if silent != [], do: {:yields, silent |> Enum.min() |> elem(1)}
  end

  defp accept(state) do
    case :gen_tcp.accept(state.listener, @every_ms) do
      {:ok, socket} ->
        state |> follow() |> admit(socket) |> report() |> accept()

      {:error, :timeout} ->
        state |> follow() |> report() |> accept()

      # A limit of the machine: wait, so that the other links live on.
      {:error, reason} when reason in [:emfile, :enfile, :enobufs, :enomem] ->
        Process.sleep(200)
        accept(state)

      {:error, :econnaborted} ->
        accept(state)

      {:error, reason} ->
        exit({:shutdown, reason})
    end
  end

  defp follow(state) do
    receive do
      {:gone, socket} -> follow(%{state | held: Map.delete(state.held, socket)})
      {:heard, socket} -> follow(%{state | held: spoken(state.held, socket)})
    after
      0 -> state
    end
  end

  defp spoken(held, socket) do
    case held do
      %{^socket => {address, _since}} -> %{held | socket => {address, nil}}
      _gone -> held
    end
  end

  defp admit(state, socket) do
    now = :erlang.monotonic_time(:millisecond)

    with {:ok, {address, _port}} <- :inet.peername(socket),
         {:ok, state} <- room(state, address, now),
         # Not before: a refused connection costs no more than it has to.
         :ok <- :inet.setopts(socket, state.options),
         :ok <- :gen_tcp.controlling_process(socket, state.link) do
      send(state.link, {:accepted, state.listener, socket, address})
      %{state | held: Map.put(state.held, socket, {address, now})}
    else
      {:refused, text} ->
        :gen_tcp.close(socket)
        %{state | refused: state.refused + 1, text: text}

      # A connection may already be closed again; the acceptor goes on.
      {:error, _closed} ->
        :gen_tcp.close(socket)
        state
    end
  end

  defp room(state, address, now) do
    case check(state.held, address, now) do
      :ok ->
        {:ok, state}

      {:yields, silent} ->
        send(state.link, {:yield, state.listener, silent})
        {:ok, %{state | held: Map.delete(state.held, silent)}}

      {:refused, text} ->
        {:refused, text}
    end
  end

  defp report(%{refused: 0} = state), do: state

  defp report(state) do
    now = :erlang.monotonic_time(:millisecond)

    if state.told == nil or now - state.told >= @every_ms do
      send(state.link, {:refused, state.listener, state.refused, state.text})
      %{state | refused: 0, told: now}
    else
      state
    end
  end
end
