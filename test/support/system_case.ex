defmodule Aerie.SystemCase do
  @moduledoc """
  A whole gateway for a test, started as `bin/run` starts it: embedded nats-server, HTTP, links, all on free ports, in its
  own folder and under its own name.
  """

  use ExUnit.CaseTemplate

  alias AerieCLI.Run

  using do
    quote do
      import Aerie.SystemCase
      alias Aerie.Store
    end
  end

  @doc """
  Starts a gateway. `options`: `links` (their URLs), `overrides` (configuration), `config_file`. Returns what `AerieCLI.Run.start/2`
  does, with `link` ports by id.
  """
  def start_gateway(folder, options \\ []) do
    supervisor = ExUnit.Callbacks.start_supervised!({DynamicTop, []}, id: make_ref())
    gateway = make_ref()

    overrides =
      Map.merge(
        %{
          "environment" => "test",
          "mavlink" => %{"local_addr" => "off"},
          "links" =>
            for(
              {url, n} <- Enum.with_index(options[:links] || [], 1),
              do: %{"id" => "link-#{n}", "url" => url}
            ),
          "http" => %{"port" => 0},
          "websocket" => %{"port" => 0},
          "sockets" => %{"dir" => short_dir()},
          "nats" => %{"port" => 0, "store_dir" => Path.join(folder, "nats")},
          "outbox" => %{"dir" => Path.join(folder, "outbox")},
          "recorder" => %{"dir" => Path.join(folder, "recordings")}
        },
        options[:overrides] || %{}
      )

    plan = %{config_file: options[:config_file], overrides: overrides, sim: 0}
    {:ok, run} = Run.start(plan, gateway: gateway, supervisor: supervisor, status: false)
    eventually(fn -> match?(%{connected: true}, Aerie.Bridge.info(gateway)) end, "NATS is connected")
    run
  end

  @doc "A new folder that is removed with the test. Its path is short, because a socket's path has at most 107 bytes."
  def short_dir do
    dir =
      Path.join(System.tmp_dir!(), "ae-#{System.pid()}-#{:erlang.unique_integer([:positive, :monotonic])}")

    File.mkdir_p!(dir)
    ExUnit.Callbacks.on_exit(fn -> File.rm_rf!(dir) end)
    dir
  end

  @doc "The port of a link, once it is open."
  def link_port(gateway, id) do
    eventually(
      fn ->
        case Aerie.Store.link(gateway, id) do
          %{port: port, status: status} when is_integer(port) and status in [:up, :idle] -> port
          _not_yet -> nil
        end
      end,
      "link #{id} is open"
    )
  end

  @doc "A UDP port that is free at the moment, for a link that needs the same port after a restart."
  def free_udp_port do
    {:ok, socket} = :gen_udp.open(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :gen_udp.close(socket)
    port
  end

  @doc "A plain NATS client of the gateway's server."
  def nats_client(gateway) do
    %URI{host: host, port: port, userinfo: token} = URI.parse(Aerie.Bridge.login_url(gateway))
    {:ok, conn} = Gnat.start_link(%{host: host, port: port, token: token})
    conn
  end

  @doc "All events of the stream, in order, decoded."
  def stream_events(conn) do
    {:ok, %{state: %{first_seq: first, last_seq: last}}} =
      Gnat.Jetstream.API.Stream.info(conn, "FLEET_EVENTS")

    # An empty stream has first 0 or 1 and last 0.
    for seq <- max(first, 1)..last//1 do
      {:ok, message} = Gnat.Jetstream.API.Stream.get_message(conn, "FLEET_EVENTS", %{seq: seq})
      JSON.decode!(message.data)
    end
  end

  @doc "See `Aerie.Patience.eventually/3`."
  @spec eventually((-> result), String.t() | (-> String.t()), integer()) :: result when result: term()
  def eventually(fun, what, deadline \\ Aerie.Patience.deadline()),
    do: Aerie.Patience.eventually(fun, what, deadline)
end

defmodule DynamicTop do
  @moduledoc false
  use Supervisor

  def start_link(_options), do: Supervisor.start_link(__MODULE__, [])

  @impl Supervisor
  def init(_options), do: Supervisor.init([], strategy: :one_for_one)
end
