defmodule Aerie.Access.HTTP.Proxy do
  @moduledoc """
  A middleware that believes a proxy what it says of the client, if it is one of `http.proxies`: `X-Forwarded-Proto` becomes the request's scheme,
  so that cookies are marked for TLS, and the last address of `X-Forwarded-For` that is not a proxy of ours its peer, so that each client
  has its own tries to sign in. Anybody can write these headers, so from others they change nothing.
  """

  @behaviour :cowboy_middleware

  alias Aerie.Base.Store

  require Logger

  @log_ms 3_600_000

  @impl :cowboy_middleware
  def execute(request, %{proxies: proxies, gateway: gateway} = env) do
    {peer, port} = :cowboy_req.peer(request)
    headers = :cowboy_req.headers(request)

    case client(peer, headers, proxies) do
      {:ok, client, scheme} ->
        {:ok, %{request | peer: {client, port}, scheme: scheme}, env}

      :direct ->
        if is_map_key(headers, "x-forwarded-proto"), do: unknown(gateway, peer)
        {:ok, request, env}
    end
  end

  @doc "The client and scheme behind a proxy of ours; `:direct` for a request of anybody else. Pure."
  @spec client(:inet.ip_address(), %{binary() => binary()}, [:inet.ip_address()]) ::
          {:ok, :inet.ip_address(), scheme :: String.t()} | :direct
  def client(peer, headers, proxies) do
    if peer in proxies,
      do: {:ok, first(headers["x-forwarded-for"], proxies) || peer, scheme(headers["x-forwarded-proto"])},
      else: :direct
  end

  # Each proxy adds whom it heard at the end; what stands before the first unknown one anybody may have written.
  defp first(nil, _proxies), do: nil

  defp first(text, proxies) do
    text
    |> String.split(",")
    |> Enum.reverse()
    |> Enum.map(&address/1)
    |> Enum.find(&(&1 not in proxies))
    |> then(&if(&1 != :unknown, do: &1))
  end

  defp address(text) do
    case text |> String.trim() |> String.trim_leading("[") |> String.trim_trailing("]") |> parse() do
      {:ok, ip} -> ip
      {:error, _reason} -> :unknown
    end
  end

  defp parse(text), do: text |> String.to_charlist() |> :inet.parse_strict_address()

  defp scheme(nil), do: "http"

  # The last one is that of the proxy next to us.
  defp scheme(text) do
    last = text |> String.split(",") |> List.last() |> String.trim() |> String.downcase()
    if last == "https", do: "https", else: "http"
  end

  defp unknown(gateway, peer) do
    Store.count_if_running(gateway, {:console, :unknown_proxy})

    if Store.with_table(gateway, :claims, false, fn _table ->
         Store.claim(gateway, {__MODULE__, peer}, @log_ms)
       end),
       do:
         Logger.warning(
           "#{:inet.ntoa(peer)} forwards requests (X-Forwarded-Proto) and is none of http.proxies: its word does not count, so cookies " <>
             "are not marked for TLS. If it is your proxy, add its address to http.proxies."
         )
  end
end
