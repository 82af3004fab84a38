defmodule Aerie.Console.Refresh do
  @moduledoc """
  Tells a page when to read the read model again, by a message `:refresh`: with each change notice, which `Aerie.Base.PubSub` sends at most
  five times a second however much has changed, and once a second if nothing has, because ages grow.
  """

  import Phoenix.LiveView

  alias Aerie.Base.PubSub
  alias Phoenix.LiveView.Socket

  @idle_ms 1_000

  @doc """
  Subscribes the page to topics of `Aerie.Base.PubSub`. Change notices (`:vehicles`, `:links`, `{:vehicle, id}`, `{:link, id}`) become
  `:refresh`; messages of other topics reach the page's `handle_info/2` as they are. Does nothing before the page is connected.
  """
  @spec subscribe(Socket.t(), [PubSub.topic()]) :: Socket.t()
  def subscribe(socket, topics \\ [:vehicles, :links]) do
    if connected?(socket) do
      Enum.each(topics, &PubSub.subscribe(socket.assigns.gateway, &1))
      begin(socket)
    else
      socket
    end
  end

  defp begin(%{private: %{console_refresh: _begun}} = socket), do: socket

  defp begin(socket) do
    socket
    |> put_private(:console_refresh, due(now() + @idle_ms, nil))
    |> attach_hook(:console_refresh, :handle_info, &handle/2)
  end

  defp handle({:fleet, topic, _changed}, socket) when topic in [:vehicles, :links], do: sooner(socket)

  defp handle({:fleet, {kind, _id}, _changed}, socket) when kind in [:vehicle, :link], do: sooner(socket)

  defp handle(:refresh, socket) do
    {:cont, put_private(socket, :console_refresh, due(now() + @idle_ms, socket.private.console_refresh))}
  end

  defp handle(_other, socket), do: {:cont, socket}

  defp sooner(%{private: %{console_refresh: %{at: at} = refresh}} = socket) do
    now = now()
    if now < at, do: {:halt, put_private(socket, :console_refresh, due(now, refresh))}, else: {:halt, socket}
  end

  # One timer at a time. If it has fired meanwhile, the page refreshes once too often.
  defp due(at, refresh) do
    _ = if refresh, do: Process.cancel_timer(refresh.timer)
    timer = Process.send_after(self(), :refresh, at, abs: true)
    %{at: at, timer: timer}
  end

  defp now, do: System.monotonic_time(:millisecond)
end
