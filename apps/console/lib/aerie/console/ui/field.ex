defmodule Aerie.Console.UI.Field do
  @moduledoc "A form field with its label, unit, hint and errors."
  use Phoenix.Component

  attr :id, :string, required: true
  attr :name, :string, required: true
  attr :label, :string, required: true
  attr :type, :string, default: "text", doc: "of the input; also `select`, `checkbox`, `textarea`"
  attr :value, :any, default: nil
  attr :options, :list, default: [], doc: "of a select, as for `Phoenix.HTML.Form.options_for_select/2`"
  attr :unit, :string, default: nil
  attr :hint, :string, default: nil
  attr :errors, :list, default: []
  attr :label_hidden, :boolean, default: false, doc: "for screen readers only"
  attr :class, :string, default: nil

  attr(:rest, :global,
    include:
      ~w(autocomplete autofocus disabled inputmode list max maxlength min minlength multiple pattern placeholder readonly required rows spellcheck step)
  )

  @doc "A field."
  def field(%{type: "checkbox"} = assigns) do
    ~H"""
    <div class={["field check", @class]}>
      <input type="hidden" name={@name} value="false" />
      <label for={@id}><input type="checkbox" id={@id} name={@name} value="true" checked={@value in [true, "true"]} {@rest} /> {@label}</label>
      <.notes id={@id} hint={@hint} errors={@errors} />
    </div>
    """
  end

  def field(assigns) do
    ~H"""
    <div class={["field", @class]}>
      <label for={@id} class={@label_hidden && "visually-hidden"}>{@label}</label>
      <span class="field-box">
        <select :if={@type == "select"} id={@id} name={@name} {described(assigns)} {@rest}>{Phoenix.HTML.Form.options_for_select(
          @options,
          @value
        )}</select>
        <textarea :if={@type == "textarea"} id={@id} name={@name} {described(assigns)} {@rest}>{@value}</textarea>
        <input :if={@type not in ~w(select textarea)} type={@type} id={@id} name={@name} value={@value} {described(assigns)} {@rest} />
        <span :if={@unit} class="unit">{@unit}</span>
      </span>
      <.notes id={@id} hint={@hint} errors={@errors} />
    </div>
    """
  end

  attr :id, :string, required: true
  attr :hint, :string, required: true
  attr :errors, :list, required: true

  defp notes(assigns) do
    ~H"""
    <p :if={@hint} id={"#{@id}-hint"} class="hint">{@hint}</p>
    <p :if={@errors != []} id={"#{@id}-errors"} class="field-error" role="alert">{Enum.join(@errors, "; ")}</p>
    """
  end

  defp described(%{id: id, hint: hint, errors: errors}) do
    notes = if(hint, do: ["#{id}-hint"], else: []) ++ if(errors != [], do: ["#{id}-errors"], else: [])

    %{
      "aria-describedby" => if(notes != [], do: Enum.join(notes, " ")),
      "aria-invalid" => if(errors != [], do: "true")
    }
  end
end
