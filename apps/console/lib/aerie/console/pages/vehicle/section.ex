defmodule Aerie.Console.Pages.Vehicle.Section do
  @moduledoc "The chosen section of a vehicle's page, from the page's assigns."
  use Aerie.Console, :component

  alias Aerie.Vehicle.{Firmware, Snapshot}
  alias Aerie.Console.Commands.{Catalog, EntryList, Form, Panel}

  alias Aerie.Console.Pages.Vehicle.{Charts, Events, Fly, Health, LinkTable}
  alias Aerie.Console.Pages.Vehicle.Health.Calibration
  alias Aerie.Console.Pages.Vehicle.Control.CommandCheck
  alias Aerie.Console.Pages.Vehicle.Sections
  alias Aerie.Console.Pages.Vehicle.Events.Timeline

  @doc "Draws the section `:section`."
  @spec section(map()) :: Phoenix.LiveView.Rendered.t()
  def section(%{section: "fly"} = assigns) do
    ~H"""
    <Fly.fly
      view={@view}
      user={@user}
      inputs={@inputs}
      modes={Firmware.modes(@view.vehicle)}
      target={@target}
      answer={@answer}
      obstacles={@obstacles}
      route={@route}
      aiming={@aiming}
      following={@following}
      events={@events}
      lines={@events |> Timeline.lines() |> Enum.take(6)}
      events_path={Sections.path(@id, "events")}
    />
    """
  end

  def section(%{section: "commands"} = assigns) do
    assigns =
      assign(assigns,
        entry: assigns.command && Catalog.entry(assigns.command, assigns.view.vehicle, assigns.user)
      )

    ~H"""
    <div class="commands">
      <Panel.catalog groups={Catalog.groups(@view.vehicle, @user, @search)} search={@search} chosen={@command} path={&Sections.command_path(@id, &1)} />
      <div class="stack">
        <Panel.panel :if={@entry} entry={@entry} fields={Form.fields(@entry.type, @view.vehicle, @form)} errors={@errors} answer={@answer} obstacles={@obstacles} />
        <section class="card" aria-labelledby="history-title">
          <h2 id="history-title">Command history</h2>
          <p :if={@lives == []} class="muted">No commands yet</p>
          <EntryList.lives id="history" lives={@lives} now={@now} user={@user} />
        </section>
      </div>
    </div>
    """
  end

  def section(%{section: "events"} = assigns) do
    assigns = assign(assigns, :shown, assigns.paused || assigns.events)

    ~H"""
    <Events.events lines={Timeline.lines(@shown, @level, @events_search)} level={@level} search={@events_search} paused={@paused != nil} total={length(@shown)} via={@view.vehicle.via} />
    """
  end

  def section(%{section: "charts"} = assigns) do
    ~H"""
    <Charts.charts vehicle={@id} series={@series} heard={@heard} message={@message} via={@view.vehicle.via} path={&Sections.charts_path(@id, &1)} />
    """
  end

  def section(%{section: "health"} = assigns) do
    ~H"""
    <Health.health
      view={@view}
      user={@user}
      arming={Snapshot.arming(@view.vehicle, @events, @now)}
      workshop={CommandCheck.workshop(assigns)}
      calibrations={Enum.filter(@lives, &Calibration.command?(&1.name))}
      now={@now}
    />
    """
  end

  def section(%{section: "links"} = assigns) do
    ~H"""
    <LinkTable.links view={@view} rows={@link_rows} />
    """
  end
end
