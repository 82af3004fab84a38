defmodule Phoenix.LiveView.Cowboy do
  @moduledoc """
  Serves pages and their WebSockets with Cowboy, in the place of Phoenix' endpoint.

      routes = Phoenix.LiveView.Cowboy.routes(server)
      :cowboy.start_clear(name, [port: 4000], %{env: %{dispatch: :cowboy_router.compile([{:_, own ++ routes}])}})

  The last route matches every path, so an application's own routes come first.
  """

  alias Phoenix.LiveView.{Channel, Cowboy, Server}

  @doc "The routes of a server: the WebSocket and, for every other path, the pages."
  @spec routes(Server.t()) :: [tuple()]
  def routes(%Server{} = server) do
    [
      {"/live/websocket", Cowboy.Socket, server},
      {:_, Cowboy.Page, server}
    ]
  end

  @doc """
  Tells every WebSocket with a view that the server restarts (close code 1012): clients connect again within seconds, without
  loading their page. Suspend the listener before (`:ranch.suspend_listener/1`). Returns when the views have ended, or after
  `timeout` milliseconds, with the number of views that have not ended.
  """
  @spec drain(Server.t(), timeout()) :: non_neg_integer()
  def drain(%Server{supervisor: supervisor}, timeout \\ 5_000) do
    views =
      for {_id, pid, _type, _modules} when is_pid(pid) <- DynamicSupervisor.which_children(supervisor),
          do: pid

    monitors = Map.new(views, &{Process.monitor(&1), &1})
    Enum.each(views, &Channel.drain/1)
    timer = Process.send_after(self(), {__MODULE__, :late, monitors}, timeout)
    left = ended(monitors, monitors)
    _ = Process.cancel_timer(timer)
    for {monitor, _view} <- left, do: Process.demonitor(monitor, [:flush])
    map_size(left)
  end

  defp ended(left, _all) when left == %{}, do: left

  defp ended(left, all) do
    receive do
      {:DOWN, monitor, :process, _view, _reason} when is_map_key(left, monitor) ->
        left |> Map.delete(monitor) |> ended(all)

      {__MODULE__, :late, ^all} ->
        left
    end
  end

  @doc false
  @spec uri(:cowboy_req.req()) :: URI.t()
  def uri(request), do: request |> :cowboy_req.uri() |> IO.iodata_to_binary() |> URI.parse()
end
