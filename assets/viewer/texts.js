// What the page says, in the language of the browser.

const ENGLISH = {
    reset: "Reset View",
    immersive: "Augmented Reality",
    leave: "Leave",
    place: "Press where it should stand.\nTo choose which way it faces, hold, and aim at a second point.",
    view: "3D view. Arrow keys orbit, plus and minus zoom, Home resets the view",
    waiting: "Waiting for a face",
    lost: "The connection is lost. Trying again",
    gone: "The head has changed. Reload the page",
    rate: "fps",
    graphics: "This browser cannot draw the head: it needs WebGL 2",
    insecure: "Augmented reality needs HTTPS, or localhost",
    unknown: "This browser has no augmented reality (WebXR)",
    unsupported: "This device has no augmented reality",
    iphone: "iPhones and iPads have no augmented reality in browsers (WebXR)",
};
const CHINESE = {
    reset: "重置视图",
    immersive: "增强现实",
    leave: "退出",
    place: "按下以选择放置位置。\n要选择朝向，请按住并瞄准第二个点。",
    view: "3D 视图。方向键环绕，加号和减号缩放，Home 键重置视图",
    waiting: "正在等待人脸",
    lost: "连接已断开，正在重试",
    gone: "头部已更改，请重新加载页面",
    rate: "fps",
    graphics: "此浏览器无法绘制头部：需要 WebGL 2",
    insecure: "增强现实需要 HTTPS 或 localhost",
    unknown: "此浏览器不支持增强现实 (WebXR)",
    unsupported: "此设备不支持增强现实",
    iphone: "iPhone 和 iPad 的浏览器不支持增强现实 (WebXR)",
};

const texts = navigator.language.startsWith("zh") ? { ...ENGLISH, ...CHINESE } : ENGLISH;
document.documentElement.lang = navigator.language.startsWith("zh") ? "zh-Hans" : "en";

export const text = (name) => texts[name];
