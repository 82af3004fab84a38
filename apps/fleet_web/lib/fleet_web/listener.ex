defmodule FleetWeb.Listener do
  @moduledoc "The name and the port of a gateway's HTTP listener."

  @doc "The name under which Ranch knows it."
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
end
