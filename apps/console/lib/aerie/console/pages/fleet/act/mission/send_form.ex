defmodule Aerie.Console.Pages.Fleet.Act.Mission.SendForm do
  @moduledoc "The files of `Aerie.Console.Pages.Fleet.Act.Mission.Send`, and what has to be agreed to."
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Fleet.Act.Mission.Routes

  attr :sheet, :any, required: true
  attr :lines, :list, required: true
  attr :facts, :map, required: true

  @doc "Above the lines."
  def form(%{lines: lines, facts: facts} = assigns) do
    assigns = assign(assigns, :agreement, lines |> Enum.filter(& &1.n) |> Routes.agreement(facts))

    ~H"""
    <div id="mission-files" class="mission-files" phx-hook="MissionFiles">
      <div class="row">
        <label class="button" for="mission-file"><.icon name="upload" />Files …<input
            id="mission-file"
            class="visually-hidden"
            type="file"
            multiple
            accept=".plan,.waypoints,.mission,.txt,.json,.xml"
          /></label>
        <.button icon="plan" data-draft>Draft of Plan</.button>
      </div>
      <ul :if={@sheet.own.files != []} aria-label="Files">
        <li :for={file <- @sheet.own.files} :key={file.name}>
          {file.name}, {Routes.items(length(file.plan.items))}
          <.button
            small
            kind="quiet"
            icon="x"
            label={"Remove #{file.name}"}
            phx-click="sheet_drop_file"
            phx-value-name={file.name}
          />
        </li>
      </ul>
      <p :if={@sheet.own.error} class="field-error" role="alert">{@sheet.own.error}</p>
      <div :if={@agreement} class="notice bad mission-agree" role="group" aria-label="To agree to">
        <ul>
          <li :for={text <- elem(@agreement, 0)}>✕ {text}</li>
        </ul>
        <label class="check">
          <input
            type="checkbox"
            id="mission-agree"
            checked={@sheet.own.agreed == elem(@agreement, 1)}
            phx-click="sheet_agree"
            phx-value-agreed={elem(@agreement, 1)}
          /> Send it nevertheless
        </label>
      </div>
    </div>
    """
  end
end
