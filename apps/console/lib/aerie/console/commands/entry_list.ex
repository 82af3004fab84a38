defmodule Aerie.Console.Commands.EntryList do
  @moduledoc "A list of commands with their states, which differ by word, icon and frame, not only by colour."
  use Aerie.Console, :component

  alias Aerie.Console.Commands.Entry

  attr :id, :string, required: true
  attr :lives, :list, required: true, doc: "`t:Aerie.Console.Commands.Entry.t/0`"
  attr :now, :integer, required: true
  attr :user, :map, required: true
  attr :class, :string, default: nil

  @doc "The list, the latest first, with a button for each command that can be cancelled."
  def lives(assigns) do
    ~H"""
    <ul id={@id} class={["lives", @class]} aria-live="polite">
      <li :for={life <- @lives} :key={life.id} id={"#{@id}-#{life.id}"} class={["life", Atom.to_string(life.tone)]} data-state={life.state}>
        <.icon name={if life.going, do: "refresh", else: sign(life.state)} />
        <span class="life-name"><strong>{life.title}</strong> <span class="muted">{life.params}</span></span>
        <.badge kind={Entry.badge(life.tone)}>{life.label}{if(life.share, do: " #{life.share} %")}</.badge>
        <span :if={life.text} class="life-text">{life.text}</span>
        <span class="life-who muted">{life.source}, {life.via}, {Aerie.Console.UI.Age.text(@now - (life.done_at || life.at))} ago</span>
        <.button :if={life.cancel and @user.role != :viewer} small={true} icon="x" phx-click="cancel" phx-value-id={life.id}>Cancel</.button>
      </li>
    </ul>
    """
  end

  defp sign(:pending), do: "clock"
  defp sign(:progress), do: "refresh"
  defp sign(:completed), do: "check"
  defp sign(:accepted), do: "info"
  defp sign(:denied), do: "lock"
  defp sign(:cancelled), do: "stop"
  defp sign(:unknown), do: "help"
  defp sign(:timeout), do: "help"
  defp sign(_refused), do: "alert"
end
