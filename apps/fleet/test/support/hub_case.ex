defmodule Aerie.HubCase do
  @moduledoc "A hub and the gateways of its vehicles in tests of `Aerie.BridgeCase`, and what the hub's stream has of them."

  import Aerie.BridgeCase
  import ExUnit.Assertions

  alias Aerie.Fleet.Diagnosis
  alias Aerie.HubServer
  alias Gnat.Jetstream.API.Stream

  @doc "The names of `n` vehicles."
  def names(n), do: for(i <- 1..n, do: "V#{i}")

  @doc "A hub with a gateway of its own and `n` vehicles, which are connected. Options are those of `HubServer.start/3` and `connect/3`."
  def start(dir, n, options \\ []),
    do: dir |> HubServer.start(names(n), options) |> connect(names(n), options)

  @doc "The hub's gateway, and those aboard. `settings`: of the hub's gateway."
  def connect(hub, vehicles, options) do
    fleet = start_bridge(HubServer.gateway(hub, options[:settings] || []))
    await_up(fleet)
    leaves = for id <- vehicles, do: {id, start_bridge(HubServer.leaf(hub, id), epoch: 1)}
    for {_id, leaf} <- leaves, do: HubServer.await_hub(leaf)
    %{hub: hub, fleet: fleet, leaves: leaves}
  end

  @doc "Makes events of each vehicle."
  def make(leaves, seqs), do: for({id, leaf} <- leaves, do: commit(leaf, id, seqs))

  @doc "Waits until all that was made is stored aboard."
  def await_aboard(leaves), do: for({_id, leaf} <- leaves, do: await_empty(leaf))

  @doc "A client with the key of the hub's gateway, as soon as its server answers."
  def conn(hub, host \\ "127.0.0.1") do
    eventually(fn ->
      case HubServer.client(hub, host) do
        {:ok, conn} -> conn
        {:error, _not_yet} -> nil
      end
    end)
  end

  @doc "One read of the stream at a time: of each vehicle, the numbers and which of them came late."
  def arrived(conn, vehicles) do
    stored = events(conn)

    Map.new(vehicles, fn id ->
      {id, for({^id, seq, head} <- stored, do: {seq, head =~ "Aerie-Backfill"})}
    end)
  end

  @doc "Waits for `n` events of each vehicle, and nothing else, in their order."
  def await_all(conn, leaves, n) do
    await_stored(conn, n * length(leaves))

    for {id, rows} <- arrived(conn, Enum.map(leaves, &elem(&1, 0))),
        do: assert({id, Enum.map(rows, &elem(&1, 0))} == {id, Enum.to_list(1..n)})
  end

  @doc "Waits until the hub's stream has `n` events, whatever its servers say meanwhile."
  def await_stored(conn, n) do
    Aerie.Patience.eventually(
      fn -> stored(conn) >= n end,
      fn -> "the streams have #{n} events: #{inspect(stored(conn))}" end
    )
  end

  defp stored(conn) do
    with {:ok, %{streams: streams}} <- Aerie.Fleet.Nats.call(conn, fn -> Stream.list(conn) end) do
      for "FLEET_EVENTS" <> _vehicle = name <- streams || [],
          {:ok, %{state: %{messages: messages}}} <- [
            Aerie.Fleet.Nats.call(conn, fn -> Stream.info(conn, name) end)
          ],
          reduce: 0,
          do: (sum -> sum + messages)
    else
      {:error, _not_now} -> 0
    end
  end

  @doc "The conditions of this name in a gateway's diagnosis."
  def told(gateway, name) do
    {conditions, _diagnosis} = Diagnosis.step(Diagnosis.new(), Diagnosis.Observations.of(gateway))
    Enum.filter(conditions, &(&1.name == name))
  end
end
