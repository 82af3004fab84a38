defmodule Aerie.Access.Launch do
  @moduledoc """
  The token in the address that `bin/run` prints, which signs in somebody on this machine with one click. It is made at
  start and stored only in the file `url` of the console's folder, which only its owner can read and which is removed
  with the gateway.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Access.PrivateFile

  require Logger

  @doc "Options: `:gateway`, `:file`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_launch))

  @doc "The address that signs in, for a server at `base` (`http://127.0.0.1:4000`); nil while there is no console."
  @spec url(Names.gateway(), String.t()) :: String.t() | nil
  def url(gateway, base) do
    with token when token != nil <- Names.value(gateway, :console_launch),
         do: "#{base}/launch?token=#{token}"
  end

  @doc "Whether this is the token."
  @spec valid?(Names.gateway(), term()) :: boolean()
  def valid?(gateway, given) do
    case Names.value(gateway, :console_launch) do
      token when is_binary(token) and is_binary(given) and byte_size(given) == byte_size(token) ->
        :crypto.hash_equals(token, given)

      _none ->
        false
    end
  end

  @doc "Writes the address into the file, once the port is known."
  @spec write(Names.gateway(), :inet.ip_address(), :inet.port_number()) :: :ok
  def write(gateway, address, port),
    do: GenServer.cast(Names.via(gateway, :console_launch), {:write, address, port})

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    token = Base.url_encode64(:crypto.strong_rand_bytes(24), padding: false)
    Names.put_value(options[:gateway], :console_launch, token)
    {:ok, Map.new(options)}
  end

  @impl GenServer
  def handle_cast({:write, address, port}, %{gateway: gateway, file: file} = state) do
    url = url(gateway, "http://#{host(address)}:#{port}")

    with {:error, text} <- PrivateFile.write(file, [url, ?\n]), do: Logger.warning(text)
    {:noreply, state}
  end

  # A server that listens on all addresses is also reachable on loopback.
  defp host({0, 0, 0, 0}), do: "127.0.0.1"
  defp host({0, 0, 0, 0, 0, 0, 0, 0}), do: "[::1]"
  defp host(address) when tuple_size(address) == 8, do: "[#{:inet.ntoa(address)}]"
  defp host(address), do: :inet.ntoa(address)

  @impl GenServer
  def terminate(_reason, %{file: file}), do: File.rm(file)

  @impl GenServer
  def format_status(status), do: Map.put(status, :state, :hidden)
end
