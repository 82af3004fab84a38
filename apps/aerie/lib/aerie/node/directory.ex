defmodule Aerie.Node.Directory do
  @moduledoc """
  What Erlang's distribution asks instead of epmd, because every VM is started with `-epmd_module` for it: which port a node has. A
  gateway keeps the answer about itself, and `Aerie.Node` writes it into a file; `bin/aerie` has read that file before it connects.

  These are the callbacks of OTP's `erl_epmd`.
  """

  @doc "Nothing runs for it."
  @spec start_link() :: :ignore
  def start_link, do: :ignore

  @doc "Sets the port of a node; call it before connecting to the node."
  @spec put(name :: String.t(), :inet.port_number()) :: :ok
  def put(name, port), do: :persistent_term.put({__MODULE__, name}, port)

  @doc "The port of a node, or nil."
  @spec port(name :: String.t()) :: :inet.port_number() | nil
  def port(name), do: :persistent_term.get({__MODULE__, name}, nil)

  @doc "The cookie that this VM takes when its port opens, so that no connection is ever made with another one."
  @spec put_cookie(atom()) :: :ok
  def put_cookie(cookie), do: :persistent_term.put({__MODULE__, :cookie}, cookie)

  @doc "Distribution listens, and accepts nobody yet."
  @spec register_node(charlist() | atom(), :inet.port_number()) :: {:ok, creation :: pos_integer()}
  def register_node(name, port), do: register_node(name, port, :inet)

  @spec register_node(charlist() | atom(), :inet.port_number(), atom()) :: {:ok, creation :: pos_integer()}
  def register_node(name, port, _family) do
    true = :erlang.set_cookie(:persistent_term.get({__MODULE__, :cookie}))
    put(to_string(name), port)
    # It tells this life of a node of that name from others; 0 to 3 have another meaning.
    {:ok, 3 + :rand.uniform(0xFFFF_FFF0)}
  end

  @spec port_please(charlist() | atom(), term(), timeout()) :: {:port, :inet.port_number(), 6} | :noport
  def port_please(name, _host, _timeout \\ :infinity) do
    case port(to_string(name)) do
      nil -> :noport
      port -> {:port, port, 6}
    end
  end

  @spec address_please(charlist() | atom(), term(), atom()) ::
          {:ok, :inet.ip_address(), :inet.port_number(), 6} | {:error, :nxdomain}
  def address_please(name, _host, _family) do
    case port(to_string(name)) do
      nil -> {:error, :nxdomain}
      port -> {:ok, {127, 0, 0, 1}, port, 6}
    end
  end

  @spec listen_port_please(charlist() | atom(), term()) :: {:ok, 0}
  def listen_port_please(_name, _host), do: {:ok, 0}

  @spec names(term()) :: {:error, :address}
  def names(_host \\ nil), do: {:error, :address}
end
