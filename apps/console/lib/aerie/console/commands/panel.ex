defmodule Aerie.Console.Commands.Panel do
  @moduledoc """
  The form of one command. Its button has to be held for what moves the vehicle, changes what it does or protects it,
  or lets something fall; otherwise it is pressed. It is off while the policy or the firmware would refuse the command.
  """
  use Aerie.Console, :component

  attr :entry, :map, required: true, doc: "`t:Aerie.Console.Commands.Catalog.entry/0`"
  attr :fields, :list, required: true, doc: "`t:Aerie.Console.Commands.Form.field/0`"
  attr :errors, :map, required: true, doc: "`t:Aerie.Console.Commands.Form.errors/0`"

  attr :answer, :any,
    default: :allow,
    doc: "what `Aerie.Control.Commands.check/2` says, nil while the form is not filled in"

  attr :obstacles, :list, default: [], doc: "what the vehicle's state says against it, in words"

  @doc "The name, meaning and form of a command, or why it cannot be given."
  def panel(assigns) do
    ~H"""
    <section class="card command-panel" aria-labelledby="command-title">
      <h2 id="command-title">{@entry.title}</h2>
      <p>{@entry.type.meaning}</p>
      <details class="hint"><summary>How it is done</summary>{nature(@entry.type)}</details>
      <p :if={@entry.gap} class="notice warn" role="note"><.icon name="info" /> <span>Not available on this vehicle: {@entry.gap}.</span></p>
      <p :if={@entry.denied} class="notice info" role="note">
        <.icon name="lock" /> <span>Not allowed: {@entry.denied}.</span>
      </p>
      <form
        :if={@entry.gap == nil and @entry.denied == nil}
        id={"command-form-#{@entry.type.name}"}
        class="command-form"
        phx-hook="CommandForm"
        phx-change="command_change"
        phx-auto-recover="ignore"
        data-type={@entry.type.name}
      >
        <.command_field :for={field <- @fields} :key={field.name} field={field} error={@errors.fields[field.name]} />
        <p :for={text <- @errors.general} class="field-error" role="alert">{text}</p>
        <.answer :if={@answer != nil} answer={@answer} obstacles={@obstacles} />
        <.hold_button
          :if={held?(@entry.type)}
          id={"command-send-#{@entry.type.name}"}
          event="command"
          kind={kind(@entry.type)}
          hold_ms={hold(@entry.type)}
          phx-value-type={@entry.type.name}
          disabled={refused?(@answer)}
          reason="It would be refused: see above"
        >
          {@entry.title} (press and hold)
        </.hold_button>
        <.button :if={not held?(@entry.type)} type="submit" kind="primary" disabled={refused?(@answer)}>
          {@entry.title}
        </.button>
      </form>
    </section>
    """
  end

  # Questions, cameras and who is in charge.
  defp held?(%{moves_vehicle?: true}), do: true
  defp held?(%{group: group}) when group in [:telemetry, :control], do: false

  defp held?(%{name: name}),
    do: name not in ~w(prearm_check gimbal) and not String.starts_with?(name, "camera_")

  defp refused?(answer), do: match?({:deny, _rule, _reason}, answer)

  attr :answer, :any, required: true
  attr :obstacles, :list, default: []

  @doc "The policy's and the firmware's answer to a command before it is sent, and what the vehicle's state says against it."
  def answer(assigns) do
    ~H"""
    <p class={["policy-answer", if(@answer == :allow, do: "ok", else: "bad")]} role="status" data-answer={if(@answer == :allow, do: "allow", else: "deny")}>
      <.icon name={if(@answer == :allow, do: "check", else: "alert")} />
      <span>{verdict_text(@answer)}</span>
    </p>
    <ul :if={@answer == :allow and @obstacles != []} class="reasons obstacles" aria-label="Before you send">
      <li :for={text <- @obstacles}><.icon name="alert" /> {text}</li>
    </ul>
    """
  end

  defp verdict_text(:allow), do: "Allowed"
  defp verdict_text({:deny, :firmware, reason}), do: "The vehicle cannot do it: #{reason}"

  defp verdict_text({:deny, _rule, reason}),
    do: "Not allowed: #{Aerie.Vehicle.Command.on_pages(reason)}"

  defp verdict_text({:error, errors}), do: "Missing: #{Enum.join(errors, "; ")}"

  attr :field, :map, required: true
  attr :error, :string, default: nil

  @doc "One parameter."
  def command_field(%{field: %{input: :tick}} = assigns) do
    ~H"""
    <.field id={"command-#{@field.name}"} name={@field.name} type="checkbox" label={"#{@field.label}: #{@field.meaning}"} value={@field.value} errors={List.wrap(@error)} />
    """
  end

  def command_field(%{field: %{input: input, suggestions: suggestions}} = assigns)
      when input in [:choice, :boolean] or suggestions != [] do
    ~H"""
    <.field
      id={"command-#{@field.name}"}
      name={@field.name}
      type="select"
      label={label(@field)}
      options={options(@field)}
      value={@field.value}
      hint={@field.meaning}
      errors={List.wrap(@error)}
    />
    """
  end

  def command_field(assigns) do
    ~H"""
    <.field
      id={"command-#{@field.name}"}
      name={@field.name}
      label={label(@field)}
      value={@field.value}
      unit={@field.unit}
      autocomplete="off"
      hint={hint(@field)}
      errors={List.wrap(@error)}
    />
    """
  end

  defp label(%{required: true, label: label}), do: label
  defp label(%{label: label}), do: label <> " (optional)"

  defp hint(%{name: "lat"}), do: "north is positive, such as 47.39771"
  defp hint(%{name: "lon"}), do: "east is positive, such as 8.54556"
  # No vehicle comes near its limits.
  defp hint(%{name: "altitude" <> _of, min: "-" <> _deep} = field), do: field.meaning

  defp hint(%{min: min, max: max} = field) when min != nil and max != nil,
    do: "#{field.meaning}; #{min} to #{max}"

  defp hint(field), do: field.meaning

  defp options(%{input: :boolean} = field), do: blank(field, [{"yes", "true"}, {"no", "false"}])

  defp options(%{input: :choice, values: values} = field),
    do: blank(field, Enum.map(values, &{String.replace(&1, "_", " "), &1}))

  defp options(%{suggestions: suggestions} = field),
    do: blank(%{field | value: ""}, Enum.map(suggestions, &{&1, &1}))

  # Without a default the empty choice comes first, so that nobody sends the first value by accident.
  defp blank(%{value: ""}, options), do: [{"–", ""} | options]
  defp blank(%{required: true}, options), do: [{"–", ""} | options]
  defp blank(_field, options), do: options

  defp nature(type) do
    [
      if(type.moves_vehicle?, do: "May move the vehicle."),
      if(type.retry == :never, do: "Sent once, never repeated."),
      if(type.confirmed_by,
        do: "Done when #{type.confirmed_by}.",
        else: "Only the vehicle's answer is known, not whether it acted."
      ),
      if(type.cancel?, do: "Can be cancelled."),
      "Permission: #{type.permission}."
    ]
    |> Enum.reject(&is_nil/1)
    |> Enum.join(" ")
  end

  defp kind(%{permission: permission}) when permission in [:force_disarm, :terminate], do: "danger"
  defp kind(_type), do: "primary"

  defp hold(%{permission: permission}) when permission in [:force_disarm, :terminate], do: 1500
  defp hold(_type), do: 800

  attr :groups, :list, required: true, doc: "of `Aerie.Console.Commands.Catalog.groups/3`"
  attr :search, :string, required: true
  attr :chosen, :string, default: nil
  attr :path, :any, required: true, doc: "a function of a command's name: the address with it chosen"

  @doc "All commands, with a search."
  def catalog(assigns) do
    ~H"""
    <section class="card command-list" aria-label="Commands">
      <form id="command-search" phx-change="command_search" phx-submit="command_search">
        <.field id="command-search-text" name="search" type="search" label="Search commands" label_hidden={true} placeholder="Search commands" value={@search} autocomplete="off" phx-debounce="150" />
      </form>
      <p :if={@groups == []} class="muted">No match</p>
      <div :for={{title, entries} <- @groups} :key={title}>
        <h3>{title}</h3>
        <ul>
          <li :for={%{gap: nil} = entry <- entries} :key={entry.type.name}>
            <.link
              patch={@path.(entry.type.name)}
              class={["command-link", entry.denied && "unavailable"]}
              aria-current={if(entry.type.name == @chosen, do: "true")}
            >
              <span>{entry.title}</span>
              <.icon :if={entry.denied} name="lock" />
            </.link>
          </li>
        </ul>
        <p :if={(n = Enum.count(entries, & &1.gap)) > 0} class="hint">{n} more: not on this firmware</p>
      </div>
    </section>
    """
  end
end
