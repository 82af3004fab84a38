defmodule FleetWeb.HTTP.Guard do
  @moduledoc """
  What no handler shall have to think of: a path, a query and the headers that are read are text. Anything else is refused
  with 400 before it is routed, because its bytes would come back in an answer, or go into a log, that cannot hold them.
  """

  @behaviour :cowboy_middleware

  alias Aerie.Store
  alias FleetWeb.API.Error

  @read ~w(host origin x-aerie-key authorization content-type upgrade sec-websocket-protocol)

  @doc "Cowboy's middlewares with this one before the others."
  @spec middlewares() :: [module()]
  def middlewares, do: [__MODULE__, :cowboy_router, :cowboy_handler]

  @impl :cowboy_middleware
  def execute(request, env) do
    case check(:cowboy_req.path(request), :cowboy_req.qs(request), :cowboy_req.headers(request)) do
      :ok ->
        {:ok, request, env}

      {:error, error} ->
        count(env, error.status)

        headers = %{
          "content-type" => "application/json; charset=utf-8",
          "cache-control" => "no-store",
          "connection" => "close"
        }

        body = [JSON.encode_to_iodata!(Error.body(error)), ?\n]
        {:stop, :cowboy_req.reply(error.status, headers, body, request)}
    end
  end

  @doc "Whether a request's path, query and headers are text. Pure."
  @spec check(binary(), binary(), %{binary() => binary()}) :: :ok | {:error, Error.t()}
  def check(path, query, headers) do
    cond do
      not text?(path) -> refuse("the path is not UTF-8, percent-encoded")
      not text?(query) -> refuse("the query is not UTF-8, percent-encoded")
      name = Enum.find(@read, &(not String.valid?(Map.get(headers, &1, "")))) -> refuse("#{name} is not text")
      true -> :ok
    end
  end

  defp refuse(words), do: {:error, Error.new(:bad_request, words)}

  defp text?(encoded), do: encoded |> URI.decode() |> String.valid?()

  defp count(%{gateway: gateway}, status) do
    Store.count(gateway, {:api, status})
  rescue
    # A gateway that is being started again counts nothing.
    ArgumentError -> 0
  end
end
