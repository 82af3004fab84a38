defmodule Aerie.Vehicle.FieldsTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.{Event, Fields}
  alias Aerie.Vehicle.Fields.{Object, Page}

  @root Path.expand("../../../../..", __DIR__)

  test "docs/telemetry.md is what the code declares: mix aerie.telemetry" do
    assert File.read!(Path.join(@root, "docs/telemetry.md")) == Page.markdown()
  end

  test "every group, event and field of a vehicle and a link is on the page, with a meaning" do
    page = Page.markdown()

    for {group, _title, fields} <- Fields.all(), field <- fields do
      assert page =~ "#{group}"
      assert field.meaning != ""
    end

    for %{name: name} <- Event.Types.all(), do: assert(page =~ name)

    for %{name: name, meaning: meaning} <- Object.short() ++ Object.long() ++ Object.link() do
      assert page =~ "`#{name}`" or page =~ name
      assert meaning != ""
    end
  end

  test "numbers have the decimals of their fields, also in lists and by names that are text" do
    assert %{lat: 47.3977418, alt_rel: 20.12} =
             Fields.rounded(:position, %{lat: 47.39774182, alt_rel: 20.1234})

    assert %{"lat" => 47.3977418} = Fields.rounded("position", %{"lat" => 47.39774182})
    assert Fields.rounded(:no_such_group, %{x: 1.23456}) == %{x: 1.23456}
    assert %{"position" => %{"alt_rel" => 20.12}} = Fields.event(%{"position" => %{"alt_rel" => 20.1234}})

    assert Object.rounded_link(%{rates: %{bytes_in: 1.26}, quality: %{loss: 0.12345}, retry_in_ms: 12.6}) ==
             %{rates: %{bytes_in: 1.3}, quality: %{loss: 0.123}, retry_in_ms: 13}
  end
end
