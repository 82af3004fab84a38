defmodule Phoenix.LiveView.Cowboy do
  @moduledoc """
  Serves pages and their WebSockets with Cowboy, in the place of Phoenix' endpoint.

      routes = Phoenix.LiveView.Cowboy.routes(server)
      :cowboy.start_clear(name, [port: 4000], %{env: %{dispatch: :cowboy_router.compile([{:_, own ++ routes}])}})

  The last route matches every path, so an application's own routes come first.
  """

  alias Phoenix.LiveView.{Cowboy, Server}

  @doc "The routes of a server: the WebSocket and, for every other path, the pages."
  @spec routes(Server.t()) :: [tuple()]
  def routes(%Server{} = server) do
    [
      {"/live/websocket", Cowboy.Socket, server},
      {:_, Cowboy.Page, server}
    ]
  end

  @doc false
  @spec uri(:cowboy_req.req()) :: URI.t()
  def uri(request), do: request |> :cowboy_req.uri() |> IO.iodata_to_binary() |> URI.parse()
end
