defmodule Gnat.Settings do
  @moduledoc "The settings of one connection: defaults, checks with readable errors."

  alias Gnat.Error

  @defaults %{
    host: "localhost",
    port: 4222,
    tcp_opts: [:binary],
    ssl_opts: [],
    tls: false,
    connection_timeout: 3_000,
    send_timeout: 10_000,
    ping_interval: 10_000,
    no_responders: false,
    auth_required: false
  }

  @optional ~w(name username password token nkey_seed jwt)a
  @keys Map.keys(@defaults) ++ @optional

  @type t :: %{required(atom()) => term()}

  @doc "Checks the settings and fills in the defaults. An unknown key is an error, so that a misspelt one is noticed."
  @spec new(map()) :: {:ok, t()} | {:error, Error.t()}
  def new(settings) when is_map(settings) do
    settings = Map.merge(@defaults, settings)

    with :ok <- known(settings),
         :ok <- Enum.find_value(settings, :ok, &bad/1),
         do: {:ok, settings}
  end

  def new(other), do: wrong("expected a map, got: #{inspect(other)}")

  defp known(settings) do
    case Map.keys(settings) -- @keys do
      [] ->
        :ok

      [key | _] ->
        wrong("unknown key #{inspect(key)}; known are #{Enum.map_join(Enum.sort(@keys), ", ", &inspect/1)}")
    end
  end

  defp bad({key, value}), do: if(not ok?(key, value), do: wrong(expected(key, value)))

  defp ok?(:host, host),
    do: (is_binary(host) and host != "") or (is_list(host) and host != []) or is_tuple(host)

  defp ok?(:port, port), do: is_integer(port) and port in 1..65_535
  defp ok?(key, list) when key in [:tcp_opts, :ssl_opts], do: is_list(list)

  defp ok?(key, flag) when key in [:tls, :no_responders, :auth_required] do
    is_boolean(flag)
  end

  defp ok?(key, ms) when key in [:connection_timeout, :send_timeout, :ping_interval] do
    is_integer(ms) and ms in 1..86_400_000
  end

  defp ok?(_text, value), do: is_binary(value)

  # The value is not shown where it may be a secret.
  defp expected(key, _value) when key in [:password, :token, :nkey_seed, :jwt],
    do: "#{inspect(key)} must be a string"

  defp expected(key, value), do: "#{inspect(key)} must be #{kind(key)}, got: #{inspect(value)}"

  defp kind(:host), do: "a host name or an address"
  defp kind(:port), do: "1 to 65535"
  defp kind(key) when key in [:tcp_opts, :ssl_opts], do: "a list of options"
  defp kind(key) when key in [:tls, :no_responders, :auth_required], do: "true or false"
  defp kind(key) when key in [:connection_timeout, :send_timeout, :ping_interval], do: "1 to 86400000 ms"
  defp kind(_text), do: "a string"

  defp wrong(text), do: {:error, Error.new({:settings, text})}
end
