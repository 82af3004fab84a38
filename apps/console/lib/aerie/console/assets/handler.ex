defmodule Aerie.Console.Assets.Handler do
  @moduledoc """
  Serves `Aerie.Console.Assets`. A name refers to a row of its table and never to a file, so no path can lead elsewhere. An
  address with the current hash may be cached for ever; with another hash, from a page before an update, it gets the current asset,
  which is not cached.
  """

  @behaviour :cowboy_handler

  alias Aerie.Console.Assets
  alias Aerie.Access.HTTP.Compression

  @impl :cowboy_handler
  def init(request, gateway) do
    name = request |> :cowboy_req.path_info() |> Enum.join("/")

    request =
      case {:cowboy_req.method(request), Assets.find(gateway, name)} do
        {method, %{} = asset} when method in ["GET", "HEAD"] ->
          current? = :cowboy_req.binding(:version, request) == Assets.version(gateway)
          serve(request, asset, current?)

        {method, nil} when method in ["GET", "HEAD"] ->
          :cowboy_req.reply(404, %{"content-type" => "text/plain"}, "not found\n", request)

        _other ->
          :cowboy_req.reply(405, %{"allow" => "GET, HEAD"}, "method not allowed\n", request)
      end

    {:ok, request, gateway}
  end

  defp serve(request, asset, current?) do
    headers = %{
      "content-type" => asset.type,
      "etag" => asset.etag,
      "vary" => "accept-encoding",
      "cache-control" => if(current?, do: "public, max-age=31536000, immutable", else: "no-cache"),
      "x-content-type-options" => "nosniff",
      "cross-origin-resource-policy" => "same-origin"
    }

    cond do
      :cowboy_req.header("if-none-match", request) == asset.etag ->
        :cowboy_req.reply(304, Map.delete(headers, "content-type"), "", request)

      asset.gzip != nil and Compression.accepted?(request) ->
        :cowboy_req.reply(200, Map.put(headers, "content-encoding", "gzip"), asset.gzip, request)

      true ->
        :cowboy_req.reply(200, headers, asset.plain || :zlib.gunzip(asset.gzip), request)
    end
  end
end
