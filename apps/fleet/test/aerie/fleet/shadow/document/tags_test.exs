defmodule Aerie.Fleet.Shadow.Document.TagsTest do
  use Aerie.ShadowCase, async: true

  alias Aerie.Base.PubSub
  alias Aerie.Fleet.Shadow.Document
  alias Aerie.Fleet.Shadow.Document.Tags

  @moduletag :tmp_dir
  @moduletag :capture_log
  @ops %{name: "ops", role: :operator, permissions: []}

  defp document(vehicle, words, until \\ nil),
    do: %Document{vehicle: vehicle, fields: %{"tags" => %{value: words, expires_at: until}}}

  test "a document's tags are noted once, end with their field or its expiry, and only so many are kept" do
    table = :ets.new(:tags, [])
    assert Tags.note(table, document("A", ["north"]))
    refute Tags.note(table, document("A", ["north"]))
    assert Tags.note(table, document("B", ["spare"], 100))
    refute Tags.note(table, %Document{vehicle: "C"})
    assert Tags.of(table, 99) == %{"A" => ["north"], "B" => ["spare"]}
    assert Tags.of(table, 100) == %{"A" => ["north"]}
    assert Tags.note(table, document("A", []))
    assert Tags.of(table, 100) == %{}

    for n <- 1..8_200, do: Tags.note(table, document("V#{n}", ["x"]))
    assert :ets.info(table, :size) <= 8_192
    assert Tags.note(table, document("V1", ["y"]))
  end

  test "tags show as a change of the vehicle, and need the permission of their field", %{tmp_dir: dir} do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
    start_supervised!({PubSub, gateway: gateway})
    start_shadow(gateway, dir)
    PubSub.subscribe(gateway, {:vehicle, "VID-009"})

    assert :ok = Shadow.tag(gateway, "VID-009", ["spare", " north", "", "north"], @ops, "console")
    assert_receive {:fleet, {:vehicle, "VID-009"}, _changed}
    assert Shadow.tags(gateway) == %{"VID-009" => ["north", "spare"]}
    assert {:error, {:role, text}} = Shadow.tag(gateway, "VID-009", [], %{@ops | role: :viewer}, "console")
    assert text =~ "telemetry, which ops does not have"
    assert :ok = Shadow.tag(gateway, "VID-009", [], @ops, "console")
    assert Shadow.tags(gateway) == %{}
  end

  test "tags of a vehicle that another gateway hears are known from its document in NATS", %{tmp_dir: dir} do
    near = start_bridge(config(dir))
    url = await_up(near)
    key = {"shadow.key", "a key that both gateways have"}
    start_shadow(near, dir, [{"nats.mode", "embedded"}, key])
    assert :ok = eventually(fn -> with {:error, _away} <- Shadow.tag(near, "VID-009", ["far"]), do: false end)

    token = URI.parse(url).userinfo
    hub = [{"nats.mode", "url"}, {"nats.url", [bare(url)]}, {"nats.token", token}]
    other = Path.join(dir, "other")
    far = start_bridge(config(other, hub))
    await_up(far)
    start_shadow(far, other, [key | hub])
    assert eventually(fn -> Shadow.tags(far) == %{"VID-009" => ["far"]} end)
    assert :ok = Shadow.tag(near, "VID-009", ["near"])
    assert eventually(fn -> Shadow.tags(far) == %{"VID-009" => ["near"]} end)
  end
end
