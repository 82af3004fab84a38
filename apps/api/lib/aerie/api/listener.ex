defmodule Aerie.Api.Listener do
  @moduledoc """
  A Cowboy listener under a supervisor of its own, and a process that watches it: if Ranch's supervisor of connections dies,
  Ranch's acceptors go on to hand each connection to the dead one, for good. Then the listener is started again.
  """
  use Supervisor

  alias Aerie.Api.Listener.Watch

  @doc "The name under which Ranch knows the listener of HTTP."
  @spec ref(term()) :: term()
  def ref(gateway), do: {__MODULE__, gateway}

  @doc "The port that it listens on."
  @spec port(term()) :: :inet.port_number()
  def port(gateway), do: port_of(ref(gateway))

  @doc "The port of a listener, by Ranch's name for it."
  @spec port_of(term()) :: :inet.port_number()
  def port_of(ref) do
    # Only a listener on a unix socket has no port.
    case :ranch.get_port(ref) do
      port when is_integer(port) -> port
    end
  end

  @doc "The specification of a listener: the arguments of `:ranch.child_spec/5`."
  @spec child_spec({term(), module(), map(), module(), map()}) :: Supervisor.child_spec()
  def child_spec({ref, _transport, _limits, _protocol, _options} = given),
    do: %{id: {__MODULE__, ref}, start: {__MODULE__, :start_link, [given]}, type: :supervisor}

  @spec start_link({term(), module(), map(), module(), map()}) :: Supervisor.on_start()
  def start_link(given), do: Supervisor.start_link(__MODULE__, given)

  @impl Supervisor
  def init({ref, transport, limits, protocol, options}) do
    Process.set_label({:listener, ref})

    Supervisor.init([:ranch.child_spec(ref, transport, limits, protocol, options), {Watch, ref}],
      strategy: :one_for_all,
      max_restarts: 10,
      max_seconds: 10
    )
  end
end
