defmodule Aerie.Console.Pages.Vehicle.GroupCard do
  @moduledoc "A card with the values of a group of a vehicle's state: names, units, age."
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Vehicle.View

  @old_us 5_000_000

  attr :id, :string, required: true
  attr :title, :string, required: true
  attr :view, View, required: true
  attr :group, :atom, required: true

  attr :fields, :list,
    required: true,
    doc: "`[{path within the group, name}]`; unknown values are left out, and the card if all are unknown"

  attr :old_us, :integer, default: @old_us
  slot :inner_block

  @doc "The card. While the group is unknown, it says so."
  def facts(assigns) do
    known =
      for {path, name} <- assigns.fields,
          path = [assigns.group | List.wrap(path)],
          View.get(assigns.view, path) not in [nil, []],
          do: {path, name}

    assigns = assign(assigns, :known, known)

    ~H"""
    <section id={@id} class="card" aria-labelledby={"#{@id}-title"}>
      <div class="spread">
        <h2 id={"#{@id}-title"}>{@title}</h2>
        <.age us={View.age(@view, @group)} limit_us={@old_us} />
      </div>
      <p :if={@known == []} class="muted">Not reported by the vehicle</p>
      <dl :if={@known != []} class="facts">
        <div :for={{path, name} <- @known} :key={name} class="fact"><dt>{name}</dt><dd>{View.text(@view, path)}</dd></div>
      </dl>
      {render_slot(@inner_block)}
    </section>
    """
  end
end
