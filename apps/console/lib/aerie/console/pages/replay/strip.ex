defmodule Aerie.Console.Pages.Replay.Strip do
  @moduledoc """
  The time line of the last 24 hours below another page's map, folded until somebody opens it (`hooks/time_strip.js`).
  A second of it leads to the replay. The page opens the event `strip` to viewers.
  """
  use Aerie.Console, :component

  import Phoenix.LiveView, only: [attach_hook: 4, push_event: 3, put_private: 3]

  alias Aerie.Console.Pages.Replay.Overview

  @doc "Has the page answer the strip."
  @spec mount(Phoenix.LiveView.Socket.t()) :: Phoenix.LiveView.Socket.t()
  def mount(socket) do
    socket
    |> put_private(:strip, nil)
    |> attach_hook(:strip_asked, :handle_event, &asked/3)
    |> attach_hook(:strip_read, :handle_info, &came/2)
  end

  defp asked("strip", _value, %{private: %{strip: nil}, assigns: %{gateway: gateway, user: user}} = socket) do
    task = Overview.task(gateway, user, :all, System.os_time(:microsecond))
    {:halt, put_private(socket, :strip, task.ref)}
  end

  defp asked("strip", _value, socket), do: {:halt, socket}
  defp asked(_other, _value, socket), do: {:cont, socket}

  defp came({ref, answer}, %{private: %{strip: ref}} = socket) when ref != nil do
    Process.demonitor(ref, [:flush])

    payload =
      case answer do
        {:ok, {:ok, overview}} -> Map.take(overview, [:from, :to, :rows, :marks])
        {:ok, {:error, text}} -> %{problem: text}
        {:busy, seconds} -> %{problem: "Too much is read at once; again in #{seconds} s.", again: seconds}
      end

    {:halt, socket |> put_private(:strip, nil) |> push_event("strip:overview", payload)}
  end

  defp came(_other, socket), do: {:cont, socket}

  attr :class, :string, default: nil

  @doc "The strip."
  def strip(assigns) do
    ~H"""
    <details id="time-strip" class={["time-strip", @class]} phx-hook="TimeStrip" phx-update="ignore">
      <summary>Last 24 hours</summary>
      <p class="time-strip-head">
        <span data-words role="status">Reading …</span>
        <.link navigate="/replay" class="button small"><.icon name="restart" /> Replay</.link>
      </p>
      <div data-line class="time-line"></div>
    </details>
    """
  end
end
