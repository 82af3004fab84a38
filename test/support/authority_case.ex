defmodule Aerie.AuthorityCase do
  @moduledoc """
  A gateway with a vehicle that counts what reaches it (`Aerie.CountingVehicle`), and programs (`Aerie.Program`) that are somebody:
  viewers, operators and admins by every way in, strangers and other vehicles by the link to vehicles from another address.
  """

  import Aerie.SystemCase
  import ExUnit.Assertions

  alias Aerie.{CountingVehicle, Program}
  alias Aerie.Base.Store
  alias MavRouter.Link
  alias MavCodec.Messages, as: M

  @vehicle {"main", 1}
  # It goes to every vehicle, whoever is in charge, and is of the class that goes last.
  @mark M.LoggingAck.id()
  # Of an operator that says nothing else; see `settle/1`.
  @marker 199

  @doc """
  Starts a gateway with a link that listens on all addresses, a counting vehicle on it, and a UDP and a TCP endpoint for each of `roles`, with
  ids such as `viewer-udp`. `options`: `overrides`, `clients` (further entries of `policy.clients`), `policy`, `links` (further
  ones), `key` (with which the vehicle signs), `params` (of the vehicle), `silent` (a vehicle that listens at one of `links`, instead of one that speaks).
  """
  @spec start_authority(Path.t(), [atom()], keyword()) :: map()
  def start_authority(folder, roles, options \\ []) do
    sockets = short_dir()
    ways = for role <- [:operator | roles] |> Enum.uniq(), way <- ~w(udp tcp), do: {role, way}

    clients =
      [%{"id" => "marker", "url" => "udpin:127.0.0.1:0"}] ++
        for {role, way} <- ways, do: %{"id" => "#{role}-#{way}", "url" => "#{way}in:127.0.0.1:0"}

    listed =
      [%{"id" => "marker", "role" => "operator"}] ++
        for {role, way} <- ways, do: %{"id" => "#{role}-#{way}", "role" => "#{role}"}

    policy = Map.merge(%{"clients" => listed ++ (options[:clients] || [])}, options[:policy] || %{})

    overrides =
      Map.merge(
        %{
          "clients" => clients,
          "policy" => policy,
          "sockets" => %{"dir" => sockets},
          "timeouts" => patient()
        },
        options[:overrides] || %{}
      )

    links = ["udpin:0.0.0.0:0" | options[:links] || []]
    %{gateway: gateway} = start_gateway(folder, links: links, overrides: overrides)
    link = link_port(gateway, "link-1")
    vehicle = options[:silent] || heard(gateway, to: link, key: options[:key], params: options[:params])
    c = %{gateway: gateway, link: link, vehicle: vehicle, sockets: sockets}
    Map.put(c, :marker, program(c, {:udp, "marker"}))
  end

  defp heard(gateway, options) do
    vehicle = start_vehicle(options)
    eventually(fn -> Store.vehicle(gateway, @vehicle) end, "the vehicle is known")
    vehicle
  end

  @doc "A vehicle that counts; see `Aerie.CountingVehicle.start_link/1`."
  @spec start_vehicle(keyword()) :: pid()
  def start_vehicle(options),
    do: ExUnit.Callbacks.start_supervised!({CountingVehicle, options}, id: make_ref())

  @doc "A program that is connected to a client's endpoint, a WebSocket (nil or its key), `mavlink.sock`, or the link to vehicles."
  @spec program(map(), {:udp | :tcp, String.t()} | {:websocket, String.t() | nil} | :unix | {:link, tuple()}) ::
          pid()
  def program(c, by) do
    ExUnit.Callbacks.start_supervised!({Program, {c.gateway, way(c, by)}},
      id: make_ref(),
      restart: :temporary
    )
  end

  defp way(c, {:udp, id}), do: {:udp, {127, 0, 0, 1}, port(c, id)}
  defp way(c, {:tcp, id}), do: {:tcp, port(c, id)}
  defp way(c, {:websocket, key}), do: {:websocket, Aerie.Api.WebSocket.port(c.gateway), key_header(key)}
  defp way(c, :unix), do: {:unix, Path.join(c.sockets, "mavlink.sock")}
  defp way(c, {:link, address}), do: {:udp, address, c.link}

  defp key_header(nil), do: []
  defp key_header(key), do: [{"x-aerie-key", key}]

  defp port(c, id), do: eventually(fn -> Link.snapshot(c.gateway, id).port end, "#{id} is open")

  @doc "An address of this machine that is not loopback; nil if it has none."
  @spec lan_address() :: :inet.ip4_address() | nil
  def lan_address do
    {:ok, interfaces} = :inet.getifaddrs()

    Enum.find(for({_name, options} <- interfaces, {:addr, a} <- options, tuple_size(a) == 4, do: a), fn
      {127, _, _, _} -> false
      {0, _, _, _} -> false
      _other -> true
    end)
  end

  @doc "Waits until all that was sent to the vehicle before has arrived; gives what was counted."
  @spec settle(map()) :: map()
  def settle(%{vehicle: vehicle} = c) do
    before = marks(vehicle)

    # UDP may lose it where much is on its way.
    eventually(
      fn ->
        Program.say(c.marker, [MavCodec.encode(%M.LoggingAck{}, system: @marker, component: 190)])
        marks(vehicle) >= before + 1
      end,
      "a mark arrives"
    )

    Map.reject(CountingVehicle.counts(vehicle), fn {{_id, system, _command, _seq}, _n} ->
      system == @marker
    end)
  end

  defp marks(vehicle) do
    Enum.sum(for {{@mark, @marker, nil, _seq}, n} <- CountingVehicle.counts(vehicle), do: n)
  end

  @doc "Asserts that nothing of these systems reached the vehicle."
  @spec reached_nothing(map(), [1..255], String.t()) :: :ok
  def reached_nothing(counts, systems, who) do
    got =
      for {{id, system, command, _seq}, n} <- counts, system in systems, do: {told(id, command), system, n}

    assert got == [], "#{who} reached the vehicle with #{inspect(got, limit: 30)}"
    :ok
  end

  @doc "A message, or a command, in words."
  @spec told(non_neg_integer(), non_neg_integer() | nil) :: String.t()
  def told(id, nil), do: MavCodec.Dialects.All.name(id) || "message #{id}"
  def told(id, command), do: "#{told(id, nil)} #{MavCodec.Enums.MavCmd.name(command) || command}"

  @doc "A COMMAND_LONG by the name of the command, with some of its fields."
  @spec command(String.t(), 1..255, keyword()) :: binary()
  def command(name, system, fields \\ []) do
    {seq, fields} = Keyword.pop(fields, :seq, 0)
    number = MavCodec.Enums.MavCmd.value(:"MAV_CMD_#{name}")
    message = struct!(%M.CommandLong{target_system: 1, target_component: 1, command: number}, fields)
    MavCodec.encode(message, system: system, component: 190, seq: seq)
  end

  @doc "The heartbeat of a ground station."
  @spec station(1..255) :: binary()
  def station(system) do
    MavCodec.encode(%M.Heartbeat{type: 6, autopilot: 8, mavlink_version: 3}, system: system, component: 190)
  end
end
