defmodule FleetWeb.Endpoint do
  @moduledoc """
  The HTTP server of one gateway instance: a Cowboy listener under a supervisor of its own.

      FleetWeb.Endpoint.start_link(gateway: :default, address: {127, 0, 0, 1}, port: 4000)

  * `gateway` - name of the `Aerie.Gateway` it shows (required)
  * `address` - IP address to listen on, default `{127, 0, 0, 1}`: what has no password is not for the network
  * `port` - TCP port, default 4000; 0 takes a free one, `port/1` tells which
  * `max_connections` - default 1000; more wait in the kernel's queue

  Bad input is Cowboy's to refuse (its limits on headers and request lines stand), and costs that connection only.
  """

  use Supervisor

  alias FleetWeb.HTTP.Handler

  @defaults [address: {127, 0, 0, 1}, port: 4000, max_connections: 1000]

  @type option ::
          {:gateway, term()}
          | {:address, :inet.ip_address()}
          | {:port, :inet.port_number()}
          | {:max_connections, pos_integer()}

  @spec start_link([option()]) :: Supervisor.on_start()
  def start_link(options) do
    options = Keyword.validate!(options, [:gateway | @defaults])
    Supervisor.start_link(__MODULE__, options)
  end

  @doc "The port that the server of `gateway` listens on."
  @spec port(term()) :: :inet.port_number()
  def port(gateway), do: :ranch.get_port(ref(gateway))

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)

    transport = %{
      socket_opts: [ip: options[:address], port: options[:port]],
      num_acceptors: 4,
      max_connections: options[:max_connections]
    }

    protocol = %{
      env: %{dispatch: :cowboy_router.compile([{:_, routes(gateway)}])},
      idle_timeout: 30_000,
      max_keepalive: 1000
    }

    children = [:ranch.child_spec(ref(gateway), :ranch_tcp, transport, :cowboy_clear, protocol)]
    Supervisor.init(children, strategy: :one_for_one)
  end

  defp routes(gateway) do
    for {path, page} <- [
          {~c"/", :index},
          {~c"/metrics", :metrics},
          {~c"/healthz", :healthz},
          {~c"/readyz", :readyz},
          {:_, :missing}
        ] do
      {path, Handler, %{page: page, gateway: gateway}}
    end
  end

  defp ref(gateway), do: {__MODULE__, gateway}
end
