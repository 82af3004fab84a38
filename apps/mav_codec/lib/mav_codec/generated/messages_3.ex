defmodule MavCodec.Generated.Messages3 do
  use MavCodec.Definition.Shard, messages: {3, 8}
end
