defmodule MavRouter.Link.Transport.TcpAcceptor do
  # One address is often a whole site behind a router, or several programs of this machine.
  @per_address 64
  @connections 256

  @moduledoc """
  Accepts the connections of a TCP server, in a process of its own that is linked to the link's: accepting blocks, and a connection
  beyond the limits is closed here, not in the path of frames. There may be #{@connections} connections to a port, #{@per_address} of them
  from one address.

  The link gets `{:accepted, listener, socket, address}` for each connection and answers `gone/2` when it has ended, and
  `{:refused, listener, n, text}` at most once a second.
  """

  alias MavRouter.Link.Transport.Net

  @every_ms 1_000

  @doc "Starts to accept for the calling process."
  @spec start(:gen_tcp.socket()) :: pid
  def start(listener) do
    link = self()

    spawn_link(fn ->
      Process.set_label({:acceptor, Net.local(listener).local})
      accept(%{listener: listener, link: link, addresses: %{}, refused: 0, text: nil, told: nil})
    end)
  end

  @doc "A connection from this address has ended."
  @spec gone(pid, :inet.ip_address()) :: :ok
  def gone(acceptor, address) do
    _ = send(acceptor, {:gone, address})
    :ok
  end

  @doc "Whether one more connection from an address has room among so many by address, or why not. Pure."
  @spec check(%{:inet.ip_address() => pos_integer}, :inet.ip_address()) :: :ok | {:refused, String.t()}
  def check(addresses, address) do
    cond do
      Map.get(addresses, address, 0) >= @per_address ->
        {:refused,
         "connections of #{:inet.ntoa(address)} are refused: it has #{@per_address}, which is the most for one address"}

      addresses |> Map.values() |> Enum.sum() >= @connections ->
        {:refused, "connections are refused: there are #{@connections}, which is the most for one port"}

      true ->
        :ok
    end
  end

  defp accept(state) do
    case :gen_tcp.accept(state.listener, @every_ms) do
      {:ok, socket} ->
        state |> forget() |> admit(socket) |> report() |> accept()

      {:error, :timeout} ->
        state |> forget() |> report() |> accept()

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

  defp forget(state) do
    receive do
      {:gone, address} -> forget(%{state | addresses: less(state.addresses, address)})
    after
      0 -> state
    end
  end

  defp less(addresses, address) do
    case addresses do
      %{^address => n} when n > 1 -> %{addresses | address => n - 1}
      _last -> Map.delete(addresses, address)
    end
  end

  defp admit(state, socket) do
    with {:ok, {address, _port}} <- :inet.peername(socket),
         :ok <- check(state.addresses, address),
         :ok <- :gen_tcp.controlling_process(socket, state.link) do
      send(state.link, {:accepted, state.listener, socket, address})
      %{state | addresses: Map.update(state.addresses, address, 1, &(&1 + 1))}
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
