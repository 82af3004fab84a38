defmodule Aerie.Console.Pages.Operations.OnMount do
  @moduledoc """
  Gives every page the strip of operations (`@operation_strip`) and *Abort all* (`@abort_all`), and handles their
  buttons. It looks when the page's clock ticks, once a second, because a step of each vehicle is a change, and heights
  change all the time, and at once when a page that has begun one sends itself `:console_operations`.
  """

  import Phoenix.LiveView

  alias Aerie.Console.Part
  alias Aerie.Console.Pages.Operations.{Strip, Words}
  alias Aerie.Base.Store
  alias Aerie.Fleet

  # As long as a landing may be under way that has no end.
  @open_s 900
  @most 4
  # Closed operations that are remembered of a user.
  @closed 64

  @doc false
  def on_mount(:default, _params, _session, socket) do
    {:cont,
     socket
     |> look()
     |> attach_hook(:console_operations, :handle_info, &handle_notice/2)
     |> attach_hook(:console_operation, :handle_event, &asked/3)}
  end

  defp handle_notice(:console_clock, socket), do: {:cont, look(socket)}
  defp handle_notice(:console_operations, socket), do: {:halt, look(socket)}
  defp handle_notice(_message, socket), do: {:cont, socket}

  defp look(%{assigns: %{gateway: gateway, user: user}} = socket) do
    closed = Store.recall(gateway, {:closed_operations, user.name}, [])
    now = System.os_time(:microsecond)

    rows =
      gateway
      |> Fleet.open_operations(@open_s)
      |> Stream.filter(&(named?(&1) and &1["id"] not in closed))
      |> Stream.map(&{&1, Words.vehicles(&1, look_at(gateway))})
      |> Stream.filter(fn {operation, words} -> Words.shown?(operation, words, now) end)
      |> Stream.map(fn {operation, words} -> row(operation, words) end)
      |> Enum.take(@most)

    flying = for {_id, holder} <- Fleet.airborne(gateway), holder in [nil, user.name], do: holder

    socket
    |> Part.keep(:operation_strip, &Strip.operation_strip/1, %{rows: rows, user: user})
    |> Part.keep(:abort_all, &Strip.abort_all/1, %{flying: length(flying), user: user})
  end

  defp look_at(gateway), do: {&Fleet.vehicle(gateway, &1), &Fleet.events(gateway, &1, since: &2)}

  # One command for one vehicle is shown where it was given.
  defp named?(%{"order" => [_only], "name" => nil}), do: false
  defp named?(_operation), do: true

  defp row(%{"counts" => counts} = operation, words) do
    all = length(words)
    {listed, more} = Words.listed(words)

    %{
      id: operation["id"],
      state: operation["state"],
      over?: operation["done_at"] != nil and operation["state"] in ~w(done stopped),
      source: operation["source"],
      then: operation["then"],
      line: Words.line(operation, words),
      listed: listed,
      more: more,
      outside: Words.outside(words),
      all: all,
      waiting: counts["waiting"],
      begun: all - counts["waiting"],
      over: counts["ok"] + counts["failed"],
      up?: "takeoff" in (operation["what"]["sequence"] || []),
      home?: "rtl" in (operation["what"]["sequence"] || [])
    }
  end

  # `Aerie.Console.SignIn.OnMount` has already refused anybody below an operator.
  defp asked("operation-pause", %{"operation" => id}, socket), do: change(socket, id, :pause)
  defp asked("operation-stop", %{"operation" => id}, socket), do: change(socket, id, :stop)

  defp asked("operation-close", %{"operation" => id}, %{assigns: %{gateway: gateway, user: user}} = socket)
       when is_binary(id) do
    key = {:closed_operations, user.name}
    :ok = Store.remember(gateway, key, Enum.take([id | Store.recall(gateway, key, [])], @closed))
    {:halt, look(socket)}
  end

  defp asked("operation-continue", %{"operation" => id, "waiting" => waiting}, socket),
    do: continue(socket, id, waiting)

  defp asked("operation-abort", %{"operation" => id, "command" => type}, socket) when type in ~w(rtl hold),
    do: change(socket, id, {:abort, type})

  defp asked("abort-all", %{"command" => type}, %{assigns: %{gateway: gateway, user: user}} = socket)
       when type in ~w(hold rtl land),
       do: told(socket, Fleet.abort_all(gateway, type, user, "console"))

  defp asked("operation-" <> _other, _value, socket), do: {:halt, socket}
  defp asked("abort-all", _value, socket), do: {:halt, socket}
  defp asked(_event, _value, socket), do: {:cont, socket}

  # As many as the button said.
  defp continue(%{assigns: %{gateway: gateway}} = socket, id, waiting) do
    case Fleet.operation(gateway, id) do
      {:ok, %{"counts" => %{"waiting" => ^waiting}}} -> change(socket, id, :continue)
      {:ok, _other} -> {:halt, put_flash(socket, :error, "The operation has changed; nothing was begun.")}
      refusal -> told(socket, refusal)
    end
  end

  defp change(%{assigns: %{gateway: gateway, user: user}} = socket, id, change) when is_binary(id),
    do: told(socket, Fleet.change_operation(gateway, id, change, user, "console"))

  defp change(socket, _id, _change), do: {:halt, socket}

  defp told(socket, {:ok, _operation}), do: {:halt, look(socket)}

  defp told(socket, {:error, refusal}),
    do: {:halt, socket |> put_flash(:error, Fleet.refusal(refusal)) |> look()}
end
