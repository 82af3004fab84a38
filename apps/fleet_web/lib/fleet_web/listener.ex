defmodule FleetWeb.Listener do
  @moduledoc "The name and the port of a gateway's HTTP listener."

  @doc "The name under which Ranch knows it."
  @spec ref(term()) :: term()
  def ref(gateway), do: {__MODULE__, gateway}

  @doc "The port that it listens on."
  @spec port(term()) :: :inet.port_number()
  def port(gateway) do
    # Only a listener on a unix socket has no port.
    case :ranch.get_port(ref(gateway)) do
      port when is_integer(port) -> port
    end
  end
end
